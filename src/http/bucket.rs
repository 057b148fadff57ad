//! Token buckets, and a bounded table of them. Pure: the caller passes the time.
//!
//! A request takes a token; tokens return at a steady rate up to the size of the bucket. A charge that is known only afterwards,
//! such as GPU time, may overdraw a bucket; the bucket then refuses until its level is positive again.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::{Duration, Instant};

/// Rate at which a bucket refills, and its size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Tokens per second; above 0.
    pub per_second: f64,
    /// Tokens of a full bucket; at least 1.
    pub burst: f64,
}

/// The token bucket of one client.
#[derive(Clone, Copy, Debug)]
pub struct Bucket {
    rate: Rate,
    level: f64,
    at: Instant,
}

impl Bucket {
    pub fn full(rate: Rate, now: Instant) -> Self {
        Self { rate, level: rate.burst, at: now }
    }

    fn refill(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.at).as_secs_f64();
        self.at = self.at.max(now);
        self.level = (self.level + passed * self.rate.per_second).min(self.rate.burst);
    }

    /// Checks that the bucket holds a token, without taking it.
    ///
    /// # Errors
    /// The time until there is one.
    pub fn check(&mut self, now: Instant) -> Result<(), Duration> {
        self.refill(now);
        if self.level >= 1.0 {
            return Ok(());
        }
        let seconds = (1.0 - self.level) / self.rate.per_second;
        Err(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
    }

    /// Takes a token.
    ///
    /// # Errors
    /// The time until there is one; nothing is taken.
    pub fn take(&mut self, now: Instant) -> Result<(), Duration> {
        self.check(now)?;
        self.level -= 1.0;
        Ok(())
    }

    /// Takes `tokens`, even if the bucket does not hold them.
    pub fn charge(&mut self, tokens: f64, now: Instant) {
        self.refill(now);
        self.level -= tokens;
    }

    fn is_full(&self, now: Instant) -> bool {
        let mut copy = *self;
        copy.refill(now);
        copy.level >= self.rate.burst
    }
}

/// Shortest time between two searches for buckets that can be dropped.
const SWEEP_EVERY: Duration = Duration::from_secs(1);

/// Buckets by key, of which there are at most `most`.
///
/// A full bucket equals one that does not exist, so full buckets are dropped when the table is full. If that makes no room, new
/// keys share one bucket: an attacker with many addresses slows other new addresses down, and needs no more memory.
#[derive(Debug)]
pub struct Table<K> {
    buckets: HashMap<K, Bucket>,
    most: usize,
    rest: Option<Bucket>,
    swept_at: Option<Instant>,
}

impl<K: Eq + Hash> Table<K> {
    pub fn new(most: usize) -> Self {
        Self { buckets: HashMap::new(), most, rest: None, swept_at: None }
    }

    /// Returns the bucket of a key, which begins full. A changed rate applies from now on.
    pub fn bucket(&mut self, key: K, rate: Rate, now: Instant) -> &mut Bucket {
        let mut has_room = self.buckets.len() < self.most || self.buckets.contains_key(&key);
        let is_due = |at: Instant| now.duration_since(at) >= SWEEP_EVERY;
        if !has_room && self.swept_at.is_none_or(is_due) {
            self.swept_at = Some(now);
            self.buckets.retain(|_, bucket| !bucket.is_full(now));
            has_room = self.buckets.len() < self.most;
        }
        let full = || Bucket::full(rate, now);
        let bucket = match has_room {
            true => self.buckets.entry(key).or_insert_with(full),
            false => self.rest.get_or_insert_with(full),
        };
        if bucket.rate != rate {
            bucket.refill(now);
            bucket.rate = rate;
        }
        bucket
    }

    /// Forgets the bucket of a key, which begins full again.
    pub fn forget(&mut self, key: &K) {
        self.buckets.remove(key);
    }
}

#[cfg(test)]
mod tests;
