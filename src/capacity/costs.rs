//! Costs of messages and of operations of the store, in nanoseconds.

/// The broker's time for each kind of message. It is a single server here: JetStream writes a stream under one lock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrokerCosts {
    /// Storing a run and acknowledging that.
    pub publish_ns: u64,
    /// A worker's pull, the delivery of a run, and the acknowledgement of its end, together.
    pub pull_and_ack_ns: u64,
    /// Storing or delivering another KiB of a run.
    pub kib_ns: u64,
    /// Word that a run is still being drawn.
    pub progress_ns: u64,
    /// A message to one subscriber: a note, or a beat.
    pub note_ns: u64,
    /// From a client to the broker and back, beside the broker's own time.
    pub trip_ns: u64,
}

/// The store's time for each kind of operation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoreCosts {
    /// Operations that are served at a time.
    pub servers: usize,
    pub put_ns: u64,
    pub get_ns: u64,
    /// Asking whether an object is there, or listing one.
    pub head_ns: u64,
    /// Time of an operation in which the store serves others: the way there and back.
    pub trip_ns: u64,
    pub bytes_per_s: f64,
}

/// The daemon's time for its films.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DaemonCosts {
    pub cores: usize,
    /// CPU time to take one frame: its note, reading it, checking it, writing it into the job's folder.
    pub frame_ns: u64,
    /// CPU time to hear one beat.
    pub beat_ns: u64,
}
