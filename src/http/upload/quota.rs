//! Limits on the number and bytes of uploads: in total and per API key.

use std::collections::HashMap;
use std::sync::Arc;

use parking_lot::Mutex;

use crate::http::access::Quotas;
use crate::http::problem::{Kind, Problem};

/// Limits on uploads. The limits per key apply where keys are required.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UploadLimits {
    pub scenes: u64,
    pub scenes_per_key: u64,
    pub bytes: u64,
    pub bytes_per_key: u64,
}

impl UploadLimits {
    /// Returns the limits for a key that has its own.
    fn within(self, own: &Quotas) -> UploadLimits {
        UploadLimits {
            scenes_per_key: own.scenes.unwrap_or(self.scenes_per_key),
            bytes_per_key: own.bytes.unwrap_or(self.bytes_per_key),
            ..self
        }
    }
}

/// Number and bytes of uploads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Held {
    pub scenes: u64,
    pub bytes: u64,
}

/// The current use of uploads' limits; clones share it.
#[derive(Clone, Default)]
pub struct Quota {
    tally: Arc<Mutex<Tally>>,
    /// Shares of uploads by id.
    kept: Arc<Mutex<HashMap<String, Share>>>,
}

#[derive(Default)]
struct Tally {
    all: Held,
    of_key: HashMap<String, Held>,
}

/// One upload's share of a [`Quota`]; dropping it gives the share back.
pub struct Share {
    limits: UploadLimits,
    tally: Arc<Mutex<Tally>>,
    key: Option<String>,
    bytes: u64,
}

impl Quota {
    /// Keeps the share of an upload until it is forgotten.
    pub fn keep(&self, id: &str, share: Share) {
        self.kept.lock().insert(id.to_owned(), share);
    }

    /// Releases the share of an upload, if there is one.
    pub fn forget(&self, id: &str) {
        self.kept.lock().remove(id);
    }

    /// Returns the name of the key that uploaded a scene: `None` if there is no such upload, `Some(None)` if it had no key.
    pub fn owner(&self, id: &str) -> Option<Option<String>> {
        self.kept.lock().get(id).map(|share| share.key.clone())
    }

    pub fn held(&self) -> Held {
        self.tally.lock().all
    }

    /// Reserves one scene for the key that uploads it, within the server's limits and the key's own.
    ///
    /// # Errors
    /// 429 when the number of scenes has reached its limit.
    pub fn admit(
        &self,
        key: Option<&str>,
        limits: UploadLimits,
        own: &Quotas,
    ) -> Result<Share, Problem> {
        let limits = limits.within(own);
        let mut tally = self.tally.lock();
        let full = |found: u64, limit: u64, whose: &str| {
            let detail = format!("there are {found} uploaded scenes{whose}; the limit is {limit}");
            Problem::new(Kind::TooManyScenes, detail)
                .accepted("DELETE an uploaded scene (/v1/scenes/{id}), then upload again")
        };
        if tally.all.scenes >= limits.scenes {
            return Err(full(tally.all.scenes, limits.scenes, ""));
        }
        if let Some(key) = key {
            let of_key = tally.of_key.get(key).copied().unwrap_or_default();
            if of_key.scenes >= limits.scenes_per_key {
                return Err(full(of_key.scenes, limits.scenes_per_key, " of this key"));
            }
        }
        tally.add(key, Held { scenes: 1, bytes: 0 });
        drop(tally);
        Ok(self.share(key, 0, limits))
    }

    /// Counts an upload that is already on disk, even beyond the limits.
    pub fn known(&self, key: Option<&str>, limits: UploadLimits, bytes: u64) -> Share {
        self.tally.lock().add(key, Held { scenes: 1, bytes });
        self.share(key, bytes, limits)
    }

    fn share(&self, key: Option<&str>, bytes: u64, limits: UploadLimits) -> Share {
        Share { limits, tally: self.tally.clone(), key: key.map(str::to_owned), bytes }
    }
}

impl Tally {
    fn add(&mut self, key: Option<&str>, more: Held) {
        let add = |held: &mut Held| {
            held.scenes += more.scenes;
            held.bytes += more.bytes;
        };
        add(&mut self.all);
        if let Some(key) = key {
            add(self.of_key.entry(key.to_owned()).or_default());
        }
    }
}

impl Share {
    pub fn key(&self) -> Option<&str> {
        self.key.as_deref()
    }

    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reserves more bytes.
    ///
    /// # Errors
    /// 507 with the figures when uploads would exceed their limit on disk.
    pub fn take(&mut self, bytes: u64) -> Result<(), Problem> {
        let limits = self.limits;
        let mut tally = self.tally.lock();
        let full = |held: u64, limit: u64, whose: &str| {
            let detail = format!(
                "the upload needs {} bytes; other uploads{whose} hold {} of at most {limit}",
                self.bytes + bytes,
                held - self.bytes
            );
            Problem::new(Kind::UploadQuota, detail)
                .accepted("a smaller upload, or DELETE other uploads and upload again")
        };
        if tally.all.bytes.saturating_add(bytes) > limits.bytes {
            return Err(full(tally.all.bytes, limits.bytes, ""));
        }
        if let Some(key) = &self.key {
            let held = tally.of_key.get(key).map_or(0, |held| held.bytes);
            if held.saturating_add(bytes) > limits.bytes_per_key {
                return Err(full(held, limits.bytes_per_key, " of this key"));
            }
        }
        tally.add(self.key.as_deref(), Held { scenes: 0, bytes });
        drop(tally);
        self.bytes += bytes;
        Ok(())
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut tally = self.tally.lock();
        tally.all.scenes -= 1;
        tally.all.bytes -= self.bytes;
        let Some(key) = &self.key else { return };
        if let Some(held) = tally.of_key.get_mut(key) {
            held.scenes -= 1;
            held.bytes -= self.bytes;
            if held.scenes == 0 {
                tally.of_key.remove(key);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: UploadLimits =
        UploadLimits { scenes: 3, scenes_per_key: 2, bytes: 100, bytes_per_key: 60 };

    #[test]
    fn scenes_are_counted_in_all_and_for_each_key() {
        let quota = Quota::default();
        let first = quota.admit(Some("a"), LIMITS, &Quotas::default()).unwrap();
        let _second = quota.admit(Some("a"), LIMITS, &Quotas::default()).unwrap();
        let refused = quota.admit(Some("a"), LIMITS, &Quotas::default()).err().unwrap();
        assert_eq!(refused.status(), 429);
        assert!(refused.detail.contains("2 uploaded scenes of this key"), "{}", refused.detail);
        let _third = quota.admit(Some("b"), LIMITS, &Quotas::default()).unwrap();
        assert!(
            quota
                .admit(None, LIMITS, &Quotas::default())
                .err()
                .unwrap()
                .detail
                .contains("3 uploaded scenes; the limit is 3")
        );
        drop(first);
        assert_eq!(quota.held(), Held { scenes: 2, bytes: 0 });
        assert!(quota.admit(Some("a"), LIMITS, &Quotas::default()).is_ok());
    }

    #[test]
    fn a_key_may_have_limits_of_its_own() {
        let quota = Quota::default();
        let own = Quotas { scenes: Some(1), bytes: Some(10), ..Quotas::default() };
        let mut only = quota.admit(Some("a"), LIMITS, &own).unwrap();
        assert!(quota.admit(Some("a"), LIMITS, &own).is_err());
        only.take(10).unwrap();
        assert_eq!(only.take(1).unwrap_err().status(), 507);
        quota.keep("town", only);
        assert_eq!(quota.owner("town"), Some(Some("a".to_owned())));
        assert_eq!(quota.owner("grid"), None);
    }

    #[test]
    fn bytes_are_counted_in_all_and_for_each_key() {
        let quota = Quota::default();
        let mut a = quota.admit(Some("a"), LIMITS, &Quotas::default()).unwrap();
        a.take(60).unwrap();
        let refused = a.take(1).unwrap_err();
        assert_eq!(refused.status(), 507);
        let mut b = quota.admit(Some("b"), LIMITS, &Quotas::default()).unwrap();
        b.take(40).unwrap();
        let refused = b.take(5).unwrap_err();
        assert!(refused.detail.contains("needs 45 bytes"), "{}", refused.detail);
        assert!(refused.detail.contains("hold 60 of at most 100"), "{}", refused.detail);
        drop(a);
        b.take(5).unwrap();
        assert_eq!(quota.held(), Held { scenes: 1, bytes: 45 });
        // Files on disk are counted even if earlier limits were larger.
        let known = quota.known(None, LIMITS, 1000);
        assert_eq!(b.take(1).unwrap_err().status(), 507);
        drop((known, b));
        assert_eq!(quota.held(), Held::default());
        assert!(quota.tally.lock().of_key.is_empty());
    }
}
