use super::*;

const RATE: Rate = Rate { per_second: 2.0, burst: 4.0 };

#[test]
fn a_bucket_tells_when_its_next_token_comes() {
    let start = Instant::now();
    let mut bucket = Bucket::full(RATE, start);
    assert_eq!((0..9).filter(|_| bucket.take(start).is_ok()).count(), 4);
    let wait = bucket.take(start).unwrap_err();
    assert_eq!(wait, Duration::from_millis(500));
    assert!(bucket.take(start + wait - Duration::from_millis(1)).is_err());
    assert!(bucket.take(start + wait).is_ok());
    // A clock that seems to run backwards neither adds nor removes tokens.
    assert!(bucket.take(start).is_err());
}

#[test]
fn a_charge_may_overdraw() {
    let start = Instant::now();
    let mut bucket = Bucket::full(RATE, start);
    bucket.charge(13.0, start);
    assert_eq!(bucket.check(start).unwrap_err(), Duration::from_secs(5));
    assert!(bucket.check(start + Duration::from_secs(5)).is_ok());
    assert!(bucket.is_full(start + Duration::from_secs(60)));
}

#[test]
fn a_table_is_bounded() {
    let start = Instant::now();
    let mut table = Table::new(100);
    let mut refused = 0;
    for key in 0..10_000_u32 {
        let bucket = table.bucket(key, RATE, start);
        bucket.charge(3.0, start);
        refused += u32::from(bucket.take(start).is_err());
    }
    assert_eq!(table.buckets.len(), 100);
    assert!(refused > 9_000, "keys without a bucket of their own share one: {refused}");
    // A key that is known keeps its own bucket.
    assert!(table.bucket(7, RATE, start).check(start).is_err());
    let later = start + Duration::from_secs(10);
    assert!(table.bucket(20_000, RATE, later).take(later).is_ok());
    assert_eq!(table.buckets.len(), 1, "full buckets are dropped");
}

#[test]
fn a_changed_rate_applies_at_once() {
    let start = Instant::now();
    let fast = Rate { per_second: 100.0, burst: 200.0 };
    // A bucket of its own, and the one that keys beyond the table share.
    for (most, next) in [(2, "a"), (0, "b")] {
        let mut table = Table::new(most);
        table.bucket("a", RATE, start).charge(4.0, start);
        let wait = table.bucket(next, fast, start).take(start).unwrap_err();
        assert_eq!(wait, Duration::from_millis(10), "{most} buckets");
    }
}
