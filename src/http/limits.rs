//! Rates of requests, per key and per address, and the GPU time of keys. The [buckets](super::bucket) decide; this module holds
//! their locks, and the quotas of the keys in force.
//!
//! A request beyond a limit is refused with 429 and the time after which it would be let in. A wrong key costs its address a token of a
//! small bucket. While that is empty, the address gets 429 for wrong keys. Right keys are let in all the same, so that nobody
//! locks out those with whom he shares an address; random keys of 128 bits need no slowing down to be safe.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant, SystemTime};

use parking_lot::{Mutex, RwLock};

use super::access::Quotas;
use super::access::signed::Caps;
use super::address;
use super::bucket::{Rate, Table};
use super::problem::{Kind, Problem};

/// Largest number of addresses, and of keys, whose buckets are kept; 4 MiB at most.
const MOST_BUCKETS: usize = 1 << 15;
/// Wrong keys of one address.
const WRONG_KEYS: Rate = Rate { per_second: 0.5, burst: 20.0 };
/// Capacity of a client's token bucket, in seconds of its rate.
const BURST_SECONDS: f64 = 2.0;

/// Longest time for which a client that has no GPU time left sleeps before it looks again: a reload may have changed its limits.
pub const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// What is known of a key that is in force.
#[derive(Clone, Copy, Debug)]
pub struct Holder {
    pub quotas: Quotas,
    /// Time from which the key is refused.
    pub expires: Option<SystemTime>,
    /// Hashes of what lets its requests in.
    pub credentials: [Option<[u8; 32]>; 2],
}

/// Whether a client that has been let in may go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    Good,
    /// Its key has no GPU time left for so long.
    Spent(Duration),
    /// Its key was removed or changed, or has expired.
    Gone,
}

/// The buckets of all clients, and the quotas of keys by the number of their clients.
pub struct Limits {
    /// `None` where no keys are required.
    holders: RwLock<Option<HashMap<u64, Holder>>>,
    by_address: Mutex<Table<IpAddr>>,
    wrong_keys: Mutex<Table<IpAddr>>,
    /// Refusals of which the audit log tells.
    told: Mutex<Table<IpAddr>>,
    by_key: Mutex<Table<u64>>,
    /// In milliseconds of GPU time.
    device: Mutex<Table<u64>>,
}

fn rate(per_second: f64) -> Rate {
    Rate { per_second, burst: (BURST_SECONDS * per_second).max(1.0) }
}

/// Rate of a quota of GPU time, in milliseconds.
fn device_rate(ms_per_minute: u64) -> Rate {
    let ms = ms_per_minute as f64;
    Rate { per_second: ms / 60.0, burst: ms }
}

impl Limits {
    pub fn new() -> Limits {
        Limits {
            holders: RwLock::new(None),
            by_address: Mutex::new(Table::new(MOST_BUCKETS)),
            wrong_keys: Mutex::new(Table::new(MOST_BUCKETS)),
            told: Mutex::new(Table::new(MOST_BUCKETS)),
            by_key: Mutex::new(Table::new(MOST_BUCKETS)),
            device: Mutex::new(Table::new(MOST_BUCKETS)),
        }
    }

    /// Puts the quotas of keys in force; `None` where no keys are required. A key whose GPU time is no longer limited owes none.
    pub fn set_holders(&self, holders: Option<HashMap<u64, Holder>>) {
        let mut device = self.device.lock();
        for (key, holder) in holders.iter().flatten() {
            if holder.quotas.device_ms_per_minute.is_none() {
                device.forget(key);
            }
        }
        drop(device);
        *self.holders.write() = holders;
    }

    /// Returns the quotas of a key.
    pub fn quotas(&self, key: u64) -> Quotas {
        let holders = self.holders.read();
        let holder = holders.as_ref().and_then(|holders| holders.get(&key));
        holder.map_or_else(Quotas::default, |holder| holder.quotas)
    }

    /// Counts a request of an address, before its key is looked at; `per_second` is the limit.
    ///
    /// # Errors
    /// 429 after too many requests.
    pub fn admit_address(
        &self,
        from: IpAddr,
        per_second: Option<f64>,
        now: Instant,
    ) -> Result<(), Problem> {
        let Some(rate) = per_second.map(rate) else { return Ok(()) };
        let mut table = self.by_address.lock();
        let bucket = table.bucket(address::network(from), rate, now);
        bucket.take(now).map_err(|wait| too_many(rate, "address", wait))
    }

    /// Counts a wrong key of an address.
    ///
    /// # Errors
    /// 429 after too many wrong keys.
    pub fn wrong_key(&self, from: IpAddr, now: Instant) -> Result<(), Problem> {
        let mut table = self.wrong_keys.lock();
        table.bucket(address::network(from), WRONG_KEYS, now).take(now).map_err(|wait| {
            Problem::new(Kind::TooManyRequests, "too many wrong API keys came from this address")
                .at("Authorization")
                .accepted("a known key, or another try after the time in Retry-After")
                .retry_after(wait)
        })
    }

    /// Returns whether the audit log is to tell of a refusal: of as many as wrong keys are looked at.
    pub fn tells_refusal(&self, from: Option<IpAddr>, now: Instant) -> bool {
        let Some(from) = from else { return true };
        self.told.lock().bucket(address::network(from), WRONG_KEYS, now).take(now).is_ok()
    }

    /// Counts a request of a key, given the number of its client.
    ///
    /// # Errors
    /// 429 after too many requests.
    pub fn admit_key(&self, key: u64, quotas: &Quotas, now: Instant) -> Result<(), Problem> {
        let Some(rate) = quotas.requests_per_second.map(rate) else { return Ok(()) };
        let mut table = self.by_key.lock();
        table.bucket(key, rate, now).take(now).map_err(|wait| too_many(rate, "key", wait))
    }

    /// Checks that a key may use the GPU.
    ///
    /// # Errors
    /// 429 when the key's GPU time is used up.
    pub fn check_device(&self, key: u64, now: Instant) -> Result<(), Problem> {
        let Some(ms) = self.quotas(key).device_ms_per_minute else { return Ok(()) };
        let mut table = self.device.lock();
        table.bucket(key, device_rate(ms), now).check(now).map_err(|wait| {
            let detail = format!("this key has used its {ms} ms of GPU time a minute");
            Problem::new(Kind::DeviceQuota, detail)
                .accepted("fewer or smaller frames, or the request after the time in Retry-After")
                .retry_after(wait)
        })
    }

    /// Charges a key for GPU time, if its time is limited.
    pub fn charge(&self, key: u64, device: Duration, now: Instant) {
        if let Some(ms) = self.quotas(key).device_ms_per_minute {
            let mut table = self.device.lock();
            table.bucket(key, device_rate(ms), now).charge(device.as_secs_f64() * 1e3, now);
        }
    }

    /// Returns whether the client of a key may go on with what it was let in for.
    pub fn standing(&self, key: u64, caps: &Caps, now: Instant, time: SystemTime) -> Standing {
        if has_passed(caps.until, time) {
            return Standing::Gone;
        }
        let holder = match &*self.holders.read() {
            None => return Standing::Good,
            Some(holders) => holders.get(&key).copied(),
        };
        let Some(holder) = holder else { return Standing::Gone };
        let is_known = caps.credential.is_none() || holder.credentials.contains(&caps.credential);
        if !is_known || has_passed(holder.expires, time) {
            return Standing::Gone;
        }
        let Some(ms) = holder.quotas.device_ms_per_minute else { return Standing::Good };
        let mut table = self.device.lock();
        match table.bucket(key, device_rate(ms), now).check(now) {
            Ok(()) => Standing::Good,
            Err(wait) => Standing::Spent(wait),
        }
    }
}

fn has_passed(end: Option<SystemTime>, time: SystemTime) -> bool {
    end.is_some_and(|end| end <= time)
}

fn too_many(rate: Rate, whose: &str, wait: Duration) -> Problem {
    let detail = format!("more than {} requests a second came from this {whose}", rate.per_second);
    Problem::new(Kind::TooManyRequests, detail)
        .accepted("the request after the time in Retry-After")
        .retry_after(wait)
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 1));
    const B: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 2));

    /// Limits with one key, `1`.
    fn with_key(quotas: Quotas, expires: Option<SystemTime>) -> Limits {
        let limits = Limits::new();
        limits.set_holders(Some(HashMap::from([(
            1,
            Holder { quotas, expires, credentials: [Some([1; 32]), None] },
        )])));
        limits
    }

    #[test]
    fn wrong_keys_slow_their_address_down() {
        let (limits, start) = (Limits::new(), Instant::now());
        for _ in 0..20 {
            limits.wrong_key(A, start).unwrap();
        }
        let refused = limits.wrong_key(A, start).unwrap_err();
        assert_eq!((refused.status(), refused.retry_after_ms), (429, Some(2000)));
        assert!(limits.wrong_key(B, start).is_ok(), "another address");
        assert!(limits.wrong_key(A, start + Duration::from_secs(2)).is_ok());
    }

    #[test]
    fn wrong_keys_of_many_addresses_share_an_allowance() {
        let (limits, start) = (Limits::new(), Instant::now());
        let let_in = |numbers: std::ops::Range<u32>| {
            let address = |number: u32| IpAddr::V4((0x0a00_0000 + number).into());
            numbers.filter(|number| limits.wrong_key(address(*number), start).is_ok()).count()
        };
        assert_eq!(let_in(0..MOST_BUCKETS as u32), MOST_BUCKETS);
        assert_eq!(let_in(1 << 20..(1 << 20) + 99), WRONG_KEYS.burst as usize);
    }

    #[test]
    fn few_refusals_are_told() {
        let (limits, start) = (Limits::new(), Instant::now());
        let told = (0..99).filter(|_| limits.tells_refusal(Some(A), start)).count();
        assert_eq!(told, 20);
        assert!(limits.tells_refusal(Some(B), start));
        assert!(limits.tells_refusal(Some(A), start + Duration::from_secs(2)));
    }

    #[test]
    fn requests_are_limited_by_address_and_by_key() {
        let (limits, start) = (Limits::new(), Instant::now());
        let let_in =
            |from| (0..99).filter(|_| limits.admit_address(from, Some(5.0), start).is_ok()).count();
        assert_eq!((let_in(A), let_in(B)), (10, 10));
        let quotas = Quotas { requests_per_second: Some(0.1), ..Quotas::default() };
        assert!(limits.admit_key(1, &quotas, start).is_ok());
        let refused = limits.admit_key(1, &quotas, start).unwrap_err();
        assert_eq!((refused.status(), refused.retry_after_ms), (429, Some(10_000)));
        assert!(limits.admit_key(1, &Quotas::default(), start).is_ok());
    }

    #[test]
    fn device_time_is_charged_afterwards() {
        let (start, time) = (Instant::now(), SystemTime::now());
        let quotas = Quotas { device_ms_per_minute: Some(600), ..Quotas::default() };
        let limits = with_key(quotas, None);
        limits.check_device(1, start).unwrap();
        limits.charge(1, Duration::from_millis(700), start);
        let refused = limits.check_device(1, start).unwrap_err();
        // 101 ms at 10 ms a second.
        assert_eq!((refused.status(), refused.retry_after_ms), (429, Some(10_100)));
        assert!(limits.admit_key(1, &quotas, start).is_ok(), "requests that draw nothing");
        assert!(matches!(limits.standing(1, &Caps::default(), start, time), Standing::Spent(_)));
        // A reload that lifts the quota lets open streams go on at once.
        let holder = Holder { quotas: Quotas::default(), expires: None, credentials: [None; 2] };
        limits.set_holders(Some(HashMap::from([(1, holder)])));
        assert_eq!(limits.standing(1, &Caps::default(), start, time), Standing::Good);
        limits.charge(1, Duration::from_secs(9), start);
        assert_eq!(limits.standing(1, &Caps::default(), start, time), Standing::Good);
    }

    #[test]
    fn time_is_charged_to_keys_that_get_a_quota_while_they_draw() {
        let (start, time) = (Instant::now(), SystemTime::now());
        let quotas = Quotas { device_ms_per_minute: Some(100), ..Quotas::default() };
        let limits = with_key(quotas, None);
        limits.charge(1, Duration::from_millis(200), start);
        assert!(matches!(limits.standing(1, &Caps::default(), start, time), Standing::Spent(_)));
    }

    #[test]
    fn keys_that_are_removed_or_expire_have_no_standing() {
        let (start, time) = (Instant::now(), SystemTime::now());
        let limits = with_key(Quotas::default(), Some(time + Duration::from_secs(5)));
        assert_eq!(limits.standing(1, &Caps::default(), start, time), Standing::Good);
        assert_eq!(
            limits.standing(1, &Caps::default(), start, time + Duration::from_secs(5)),
            Standing::Gone
        );
        assert_eq!(limits.standing(2, &Caps::default(), start, time), Standing::Gone);
        let of = |caps: Caps| limits.standing(1, &caps, start, time);
        let credential = |byte: u8| Caps { credential: Some([byte; 32]), ..Caps::default() };
        assert_eq!((of(credential(1)), of(credential(2))), (Standing::Good, Standing::Gone));
        assert_eq!(of(Caps { until: Some(time), ..Caps::default() }), Standing::Gone);
        limits.set_holders(None);
        assert_eq!(limits.standing(2, &Caps::default(), start, time), Standing::Good);
    }
}
