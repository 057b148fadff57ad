//! Rates of requests, per key and per address, and the GPU time of keys. The [buckets](super::bucket) decide; this module holds
//! their locks.
//!
//! A limit is refused with 429 and the time after which the request would be let in. A wrong key costs its address a token of a
//! small bucket. While that is empty, the address's keys are not even looked at, so that nobody can try keys quickly.

use std::net::IpAddr;
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::access::Quotas;
use super::address;
use super::bucket::{Rate, Table};
use super::problem::{Kind, Problem};

/// Largest number of addresses, and of keys, whose buckets are kept; 4 MiB at most.
const MOST_BUCKETS: usize = 1 << 15;
/// Wrong keys of one address.
const WRONG_KEYS: Rate = Rate { per_second: 0.5, burst: 20.0 };
/// Seconds of its rate that a client may use at once.
const BURST_SECONDS: f64 = 2.0;

/// The buckets of all clients.
pub struct Limits {
    per_address: Option<Rate>,
    by_address: Mutex<Table<IpAddr>>,
    wrong_keys: Mutex<Table<IpAddr>>,
    by_key: Mutex<Table<u64>>,
    /// In milliseconds of GPU time.
    device: Mutex<Table<u64>>,
}

fn rate(per_second: f64) -> Rate {
    Rate { per_second, burst: (BURST_SECONDS * per_second).max(1.0) }
}

impl Limits {
    /// Limits each address to `per_second` requests, if given.
    pub fn new(per_second: Option<f64>) -> Limits {
        Limits {
            per_address: per_second.map(rate),
            by_address: Mutex::new(Table::new(MOST_BUCKETS)),
            wrong_keys: Mutex::new(Table::new(MOST_BUCKETS)),
            by_key: Mutex::new(Table::new(MOST_BUCKETS)),
            device: Mutex::new(Table::new(MOST_BUCKETS)),
        }
    }

    /// Counts a request of an address, before its key is looked at.
    ///
    /// # Errors
    /// 429 after too many requests; if the request has a key, also after too many wrong keys.
    pub fn admit_address(&self, from: IpAddr, has_key: bool, now: Instant) -> Result<(), Problem> {
        let from = address::network(from);
        if has_key && let Some(bucket) = self.wrong_keys.lock().existing(&from) {
            bucket.check(now).map_err(|wait| {
                Problem::new(
                    Kind::TooManyRequests,
                    "too many wrong API keys came from this address",
                )
                .at("Authorization")
                .accepted("a known key, after the time in Retry-After")
                .retry_after(wait)
            })?;
        }
        let Some(rate) = self.per_address else { return Ok(()) };
        let mut table = self.by_address.lock();
        table.bucket(from, rate, now).take(now).map_err(|wait| too_many(rate, "address", wait))
    }

    /// Counts a wrong key of an address.
    pub fn wrong_key(&self, from: IpAddr, now: Instant) {
        let from = address::network(from);
        self.wrong_keys.lock().bucket(from, WRONG_KEYS, now).charge(1.0, now);
    }

    /// Counts a request of a key, given the number of its client. `draws` tells whether the request uses the GPU.
    ///
    /// # Errors
    /// 429 after too many requests, or when the key's GPU time is used up.
    pub fn admit_key(
        &self,
        key: u64,
        quotas: &Quotas,
        draws: bool,
        now: Instant,
    ) -> Result<(), Problem> {
        if let Some(rate) = quotas.requests_per_second.map(rate) {
            let mut table = self.by_key.lock();
            table.bucket(key, rate, now).take(now).map_err(|wait| too_many(rate, "key", wait))?;
        }
        if draws && let Some(ms) = quotas.device_ms_per_minute {
            let rate = Rate { per_second: ms as f64 / 60.0, burst: ms as f64 };
            self.device.lock().bucket(key, rate, now).check(now).map_err(|wait| {
                let detail = format!("this key has used its {ms} ms of GPU time a minute");
                Problem::new(Kind::DeviceQuota, detail)
                    .accepted(
                        "fewer or smaller frames, or the request after the time in Retry-After",
                    )
                    .retry_after(wait)
            })?;
        }
        Ok(())
    }

    /// Charges a key for GPU time, if its time is limited.
    pub fn charge(&self, key: u64, device: Duration, now: Instant) {
        if let Some(bucket) = self.device.lock().existing(&key) {
            bucket.charge(device.as_secs_f64() * 1e3, now);
        }
    }

    /// Returns the time until a key has GPU time again; `None` if it has some, or if its time is not limited.
    pub fn device_wait(&self, key: u64, now: Instant) -> Option<Duration> {
        self.device.lock().existing(&key)?.check(now).err()
    }
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

    #[test]
    fn wrong_keys_slow_their_address_down() {
        let (limits, start) = (Limits::new(None), Instant::now());
        for _ in 0..20 {
            limits.admit_address(A, true, start).unwrap();
            limits.wrong_key(A, start);
        }
        let refused = limits.admit_address(A, true, start).unwrap_err();
        assert_eq!((refused.status(), refused.retry_after_ms), (429, Some(2000)));
        assert!(limits.admit_address(A, false, start).is_ok(), "requests without a key");
        assert!(limits.admit_address(B, true, start).is_ok(), "another address");
        assert!(limits.admit_address(A, true, start + Duration::from_secs(2)).is_ok());
    }

    #[test]
    fn requests_are_limited_by_address_and_by_key() {
        let (limits, start) = (Limits::new(Some(5.0)), Instant::now());
        let let_in =
            |from| (0..99).filter(|_| limits.admit_address(from, false, start).is_ok()).count();
        assert_eq!((let_in(A), let_in(B)), (10, 10));
        let quotas = Quotas { requests_per_second: Some(0.1), ..Quotas::default() };
        assert!(limits.admit_key(1, &quotas, false, start).is_ok());
        let refused = limits.admit_key(1, &quotas, false, start).unwrap_err();
        assert_eq!((refused.status(), refused.retry_after_ms), (429, Some(10_000)));
        assert!(limits.admit_key(1, &Quotas::default(), true, start).is_ok());
    }

    #[test]
    fn device_time_is_charged_afterwards() {
        let (limits, start) = (Limits::new(None), Instant::now());
        let quotas = Quotas { device_ms_per_minute: Some(600), ..Quotas::default() };
        limits.admit_key(1, &quotas, true, start).unwrap();
        limits.charge(1, Duration::from_millis(700), start);
        limits.charge(2, Duration::from_secs(9), start);
        let refused = limits.admit_key(1, &quotas, true, start).unwrap_err();
        // 101 ms at 10 ms a second.
        assert_eq!((refused.status(), refused.retry_after_ms), (429, Some(10_100)));
        assert!(limits.admit_key(1, &quotas, false, start).is_ok(), "requests that draw nothing");
        assert!(limits.admit_key(2, &quotas, true, start).is_ok());
        assert!(limits.device_wait(1, start).is_some() && limits.device_wait(2, start).is_none());
    }
}
