//! Eviction when there is no room: whole scenes leave, those used the longest ago first, each with the assets that no other
//! scene draws. A scene's own lists count as much as its assets: with many instances they are the larger part.

use std::collections::HashSet;

/// Figures of a resident scene that the choice uses.
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

/// The scenes to evict so that `bytes` are freed, all where even that is too little. None of them could stay, and those
/// used before the newest of them would not do. Assets in `kept` are not freed with any scene.
pub(super) fn victims<'a>(
    holdings: &[Holding<'a>],
    asset_bytes: impl Fn(u64) -> u64,
    kept: &HashSet<u64>,
    bytes: u64,
) -> Vec<&'a str> {
    let freed = |gone: &[&Holding<'a>]| {
        let going: HashSet<&str> = gone.iter().map(|holding| holding.id).collect();
        let staying = holdings.iter().filter(|holding| !going.contains(holding.id));
        let held: HashSet<u64> = staying.flat_map(|holding| holding.asset_uids).copied().collect();
        let assets: HashSet<u64> =
            gone.iter().flat_map(|holding| holding.asset_uids).copied().collect();
        let free = assets.into_iter().filter(|uid| !held.contains(uid) && !kept.contains(uid));
        gone.iter().map(|holding| holding.list_bytes).sum::<u64>()
            + free.map(&asset_bytes).sum::<u64>()
    };
    let mut order: Vec<&Holding<'a>> = holdings.iter().collect();
    order.sort_by_key(|holding| (holding.last_used, holding.id));
    // More scenes free more: the shortest run of the oldest that frees enough is found by halving.
    let (mut too_few, mut enough) = (0, order.len());
    while too_few < enough {
        let middle = (too_few + enough) / 2;
        if freed(&order[..middle]) >= bytes {
            enough = middle;
        } else {
            too_few = middle + 1;
        }
    }
    let mut gone = order[..enough].to_vec();
    // An old scene may free little because its assets stay; it is spared where a later one frees enough.
    for index in (0..gone.len()).rev() {
        let spared = gone.remove(index);
        if freed(&gone) < bytes {
            gone.insert(index, spared);
        }
    }
    gone.into_iter().map(|holding| holding.id).collect()
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
            for spared in &gone {
                let fewer: Vec<&str> = gone.iter().copied().filter(|id| id != spared).collect();
                prop_assert!(freed(&fewer) < wanted, "{spared} could stay");
            }
            let age = |h: &Holding| (h.last_used, h.id.to_owned());
            let newest = holdings.iter().filter(|h| gone.contains(&h.id)).map(age).max();
            if let Some(newest) = newest {
                let older: Vec<&str> =
                    holdings.iter().filter(|h| age(h) < newest).map(|h| h.id).collect();
                prop_assert!(freed(&older) < wanted, "older ones would do");
            }
        }
    }
}
