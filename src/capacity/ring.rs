//! Consistent hashing of scenes to daemons, as load balancers do it, with or without a bound of a daemon's load.

use crate::scene::random::mix;

/// Points of daemons on a ring of hashes. A scene goes to the daemon of the next point.
#[derive(Clone, Debug)]
pub struct Ring(Vec<(u64, usize)>);

impl Ring {
    /// Makes a ring with `points` points for each daemon.
    pub fn new(daemons: usize, points: usize) -> Ring {
        let point = |daemon: usize, number: usize| mix(mix(daemon as u64 + 1) ^ number as u64);
        let all = (0..daemons).flat_map(|daemon| (0..points).map(move |number| (daemon, number)));
        let mut ring: Vec<(u64, usize)> =
            all.map(|(daemon, number)| (point(daemon, number), daemon)).collect();
        ring.sort_unstable();
        Ring(ring)
    }

    /// Returns the first daemon for a scene that may take it.
    pub fn daemon(&self, scene: usize, mut may: impl FnMut(usize) -> bool) -> Option<usize> {
        let hash = mix(!(scene as u64));
        let first = self.0.partition_point(|(point, _)| *point < hash);
        let points = self.0[first..].iter().chain(&self.0[..first]);
        points.map(|(_, daemon)| *daemon).find(|daemon| may(*daemon))
    }
}

/// Returns whether a daemon with `load` requests may take another, if none may have more than `bound` times the mean (V. Mirrokni, M.
/// Thorup, M. Zadimoghaddam, SODA 2018).
pub fn is_within(bound: f64, load: usize, total: usize, daemons: usize) -> bool {
    let most = (bound * (total + 1) as f64 / daemons.max(1) as f64).ceil();
    ((load + 1) as f64) <= most
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_daemon_moves_its_own_scenes_alone() {
        let ring = Ring::new(10, 160);
        let before: Vec<usize> =
            (0..20_000).filter_map(|scene| ring.daemon(scene, |_| true)).collect();
        let after: Vec<usize> =
            (0..20_000).filter_map(|scene| ring.daemon(scene, |daemon| daemon != 3)).collect();
        let moved = before.iter().zip(&after).filter(|(before, after)| before != after).count();
        let lost = before.iter().filter(|daemon| **daemon == 3).count();
        assert_eq!((moved, before.len()), (lost, 20_000));
        assert!((1_500..2_500).contains(&lost), "{lost}");
        assert_eq!(ring.daemon(5, |_| false), None);
    }

    #[test]
    fn no_daemon_takes_more_than_its_bound() {
        let (ring, daemons) = (Ring::new(8, 16), 8);
        let mut loads = vec![0usize; daemons];
        for total in 0..4000 {
            // Everybody wants the same scene.
            let daemon = ring.daemon(0, |daemon| is_within(1.25, loads[daemon], total, daemons));
            loads[daemon.unwrap()] += 1;
        }
        assert_eq!(loads.iter().sum::<usize>(), 4000);
        assert!(loads.iter().all(|load| *load <= 625), "{loads:?}");
    }
}
