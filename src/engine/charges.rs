//! The queue charges clients for the device time of their frames: by estimates when frames are taken, by measured times at the end.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::frame_job::FrameJob;
use super::queue::{Client, Waiting};
use super::resolved::ResolvedFrame;
use super::state::{EngineState, Schedule};
use super::{Engine, EngineError};

impl EngineState {
    /// A job that was taken has had nothing of the device.
    pub fn refund(&self, job: &FrameJob) {
        if let Some((client, charged_ns)) = job.settle() {
            self.schedule.lock().queue.settle(client, charged_ns, 0);
        }
    }

    /// Puts right what clients were charged for jobs that are under way no more, by the device time that each took, and folds
    /// in that their submission `took` so long.
    pub fn settle(&self, jobs: &[(Arc<FrameJob>, Option<u64>)], took: Duration) {
        let mut schedule = self.schedule.lock();
        let Schedule { queue, costs, .. } = &mut *schedule;
        let mut cost_ns = 0;
        let now = Instant::now();
        for (job, measured_ns) in jobs {
            let Some((client, charged_ns)) = job.settle() else { continue };
            queue.landed(client, now);
            let own_ns = measured_ns.unwrap_or(charged_ns);
            queue.settle(client, charged_ns, own_ns);
            self.tell_spent(client, Duration::from_nanos(own_ns));
            cost_ns += own_ns;
            if let Some(ns) = *measured_ns {
                costs.measured(job.frame.cost_key, ns);
            }
        }
        costs.landed(cost_ns, took);
    }

    /// Charges the client of a frame that was ended before it was done for the time that it took until then. If somebody has joined it
    /// meanwhile, it waits for another turn.
    pub fn settle_given_up(&self, job: &Arc<FrameJob>, took: Duration) {
        self.stats.given_up.fetch_add(1, Ordering::Relaxed);
        if !job.is_abandoned() {
            if let Some((client, _)) = job.charged() {
                self.tell_spent(client, took);
            }
            return self.put_back(vec![job.clone()]);
        }
        let Some((client, charged_ns)) = job.settle() else { return };
        let mut schedule = self.schedule.lock();
        schedule.queue.landed(client, Instant::now());
        schedule.queue.settle(client, charged_ns, took.as_nanos() as u64);
        drop(schedule);
        self.tell_spent(client, took);
        // A client that joins the frame now has to ask again.
        self.answer(job, Err(EngineError::Busy { retry_after: Duration::ZERO }));
    }

    /// Tells the observer of device time that a caller's frame has taken.
    fn tell_spent(&self, client: Client, device: Duration) {
        if let (Some(observer), Some(caller)) = (self.observer.get(), client.owner()) {
            observer.spent(caller, device);
        }
    }
}

impl Engine {
    /// Returns the GPU time that a frame is estimated to take, from earlier frames of its kind.
    pub fn estimated_cost(&self, frame: &ResolvedFrame) -> Duration {
        let schedule = self.state().schedule.lock();
        Duration::from_nanos(schedule.costs.estimate_ns(frame.cost_key))
    }
}
