//! Groups the jobs of a batch that the same dispatches draw. Pure: it holds no device.

/// Splits `jobs` into groups whose members have the same `key`, of at most the size that `most` allows; a job without a key forms
/// its own group. Groups come in the order of their first members, members in the order of `jobs`.
pub fn groups<J: Clone, K: PartialEq>(
    jobs: &[J],
    key: impl Fn(&J) -> Option<K>,
    most: impl Fn(&J) -> usize,
) -> Vec<Vec<J>> {
    let mut groups: Vec<(Option<K>, Vec<J>)> = Vec::new();
    for job in jobs {
        let key = key(job);
        let room = most(job);
        let open = groups
            .iter_mut()
            .find(|(other, members)| key.is_some() && *other == key && members.len() < room);
        match open {
            Some((_, members)) => members.push(job.clone()),
            None => groups.push((key, vec![job.clone()])),
        }
    }
    groups.into_iter().map(|(_, members)| members).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]
        #[test]
        fn every_job_is_in_one_group_of_its_like(
            jobs in prop::collection::vec((0u32..4, any::<bool>()), 0..40),
            most in 1usize..6,
        ) {
            let numbered: Vec<(usize, u32, bool)> =
                jobs.iter().enumerate().map(|(number, &(kind, alone))| (number, kind, alone)).collect();
            let groups = groups(&numbered, |job| (!job.2).then_some(job.1), |_| most);
            let mut seen: Vec<usize> = groups.iter().flatten().map(|job| job.0).collect();
            seen.sort_unstable();
            prop_assert_eq!(seen, (0..jobs.len()).collect::<Vec<_>>());
            for group in &groups {
                prop_assert!(!group.is_empty() && group.len() <= most);
                prop_assert!(group.iter().all(|job| job.1 == group[0].1));
                prop_assert!(group.len() == 1 || group.iter().all(|job| !job.2));
                prop_assert!(group.windows(2).all(|pair| pair[0].0 < pair[1].0));
            }
            // There are as few groups as the limits allow.
            for kind in 0..4 {
                let alike = jobs.iter().filter(|job| **job == (kind, false)).count();
                let found = groups.iter().filter(|group| group[0].1 == kind && !group[0].2).count();
                prop_assert_eq!(found, alike.div_ceil(most));
            }
            prop_assert!(groups.windows(2).all(|pair| pair[0][0].0 < pair[1][0].0));
        }
    }
}
