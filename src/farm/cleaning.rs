//! The daily cleaning of the store.

use std::time::{Duration, SystemTime};

use super::store::{Store, StoreError, Suspects};

/// Interval at which the store is cleaned, and the time before the first cleaning.
const CLEAN_EVERY: Duration = Duration::from_secs(24 * 3600);
const CLEAN_AFTER: Duration = Duration::from_secs(3600);

/// Removes what no film needs, for as long as the process lives.
pub async fn clean_daily(store: Store) {
    // Not at once: servers that start together would clean together.
    let mut pause = CLEAN_AFTER;
    let mut suspects = Suspects::new();
    loop {
        tokio::time::sleep(pause).await;
        pause = CLEAN_EVERY;
        let [films, files] = clean(&store, SystemTime::now(), &mut suspects).await;
        for (what, cleaned) in
            [("films that no server draws", films), ("files that no film needs", files)]
        {
            match cleaned {
                Ok(0) => {}
                Ok(count) => tracing::info!("{count} {what} are removed from the store"),
                Err(error) => tracing::warn!(%error, "cannot remove {what} from the store"),
            }
        }
    }
}

/// Removes old films and old files, and returns how many of each. A film that cannot be removed does not keep the files of others.
async fn clean(
    store: &Store,
    now: SystemTime,
    suspects: &mut Suspects,
) -> [Result<usize, StoreError>; 2] {
    [store.clean_films(now, suspects).await, store.clean(now).await]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn files_are_removed_although_a_film_cannot_be() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path().to_str().unwrap()).unwrap();
        store.claim().await.unwrap();
        // A folder in place of the order cannot be removed.
        let order = folder.path().join("films").join("a".repeat(32)).join("order.json");
        std::fs::create_dir_all(&order).unwrap();
        std::fs::write(order.join("part"), "").unwrap();
        let assets = folder.path().join("assets");
        std::fs::create_dir(&assets).unwrap();
        std::fs::write(assets.join("0".repeat(64)), "ply").unwrap();
        let late = SystemTime::now() + Duration::from_secs(30 * 24 * 3600);
        let mut suspects = Suspects::new();
        assert_eq!(store.clean_films(late, &mut suspects).await.unwrap(), 0);
        let [films, files] = clean(&store, late, &mut suspects).await;
        assert!(films.is_err());
        assert_eq!(files.unwrap(), 1);
    }
}
