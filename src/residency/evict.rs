//! Who leaves when there is no room: whole scenes, the one used the longest ago first, each with the assets that no other
//! scene draws. A scene's own lists count as much as its assets: with many instances they are the larger part.

use std::collections::{HashMap, HashSet};

/// What a resident scene holds, as the choice sees it.
#[derive(Clone, Debug)]
pub(super) struct Holding<'a> {
    pub id: &'a str,
    /// Clock of the last frame.
    pub last_used: u64,
    /// Bytes of its own lists.
    pub list_bytes: u64,
    /// Identifiers of its assets; repeated ones count once.
    pub asset_uids: &'a [u64],
}

/// The scenes to evict, in order, so that `bytes` are freed: no more of them than needed, all where even that is too
/// little. Assets in `kept` are not freed with any scene.
pub(super) fn victims<'a>(
    holdings: &[Holding<'a>],
    asset_bytes: impl Fn(u64) -> u64,
    kept: &HashSet<u64>,
    bytes: u64,
) -> Vec<&'a str> {
    let distinct =
        |holding: &Holding<'a>| holding.asset_uids.iter().copied().collect::<HashSet<_>>();
    let mut users: HashMap<u64, usize> = HashMap::new();
    for uid in holdings.iter().flat_map(distinct) {
        *users.entry(uid).or_default() += 1;
    }
    let mut oldest_first: Vec<&Holding<'a>> = holdings.iter().collect();
    oldest_first.sort_by_key(|holding| (holding.last_used, holding.id));
    let mut freed = 0u64;
    let mut out = Vec::new();
    for holding in oldest_first {
        if freed >= bytes {
            break;
        }
        freed += holding.list_bytes;
        for uid in distinct(holding) {
            let left = users.entry(uid).or_default();
            *left = left.saturating_sub(1);
            if *left == 0 && !kept.contains(&uid) {
                freed += asset_bytes(uid);
            }
        }
        out.push(holding.id);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bytes that stay when the scenes in `gone` are evicted, counted anew.
    fn staying(holdings: &[Holding], bytes: &[u64], kept: &HashSet<u64>, gone: &[&str]) -> u64 {
        let stay: Vec<_> = holdings.iter().filter(|h| !gone.contains(&h.id)).collect();
        let assets: HashSet<u64> = stay
            .iter()
            .flat_map(|h| h.asset_uids.iter().copied())
            .chain(kept.iter().copied())
            .collect();
        stay.iter().map(|h| h.list_bytes).sum::<u64>()
            + assets.iter().map(|uid| bytes[*uid as usize]).sum::<u64>()
    }

    proptest! {
        #[test]
        fn enough_goes_and_no_more_and_the_oldest_first(
            scenes in prop::collection::vec(
                (0u64..6, 0u64..50, prop::collection::vec(0u64..5, 0..4)), 0..8),
            bytes in prop::collection::vec(0u64..50, 5),
            kept in prop::collection::hash_set(0u64..5, 0..3),
            wanted in 0u64..400,
        ) {
            let ids: Vec<String> = (0..scenes.len()).map(|number| number.to_string()).collect();
            let holdings: Vec<Holding> = scenes.iter().zip(&ids).map(|((last_used, list_bytes, uids), id)| {
                Holding { id, last_used: *last_used, list_bytes: *list_bytes, asset_uids: uids }
            }).collect();
            let gone = victims(&holdings, |uid| bytes[uid as usize], &kept, wanted);
            let before = staying(&holdings, &bytes, &kept, &[]);
            let freed = |gone: &[&str]| before - staying(&holdings, &bytes, &kept, gone);
            prop_assert!(freed(&gone) >= wanted || gone.len() == holdings.len());
            if let Some((_, fewer)) = gone.split_last() {
                prop_assert!(freed(fewer) < wanted, "one less would do");
            }
            let used = |id: &str| holdings.iter().find(|h| h.id == id).unwrap().last_used;
            let newest_gone = gone.iter().map(|id| used(id)).max().unwrap_or(0);
            for holding in &holdings {
                prop_assert!(gone.contains(&holding.id) || holding.last_used >= newest_gone);
            }
        }
    }
}
