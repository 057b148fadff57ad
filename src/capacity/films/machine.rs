//! The store, and cores that daemon and workers may share.

use std::collections::BTreeMap;

use super::{Event, Name, World};
use crate::capacity::costs::StoreCosts;
use crate::capacity::station::{Cores, Station};

/// Kinds of operations of the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    Put,
    Get,
    Head,
}

#[derive(Debug)]
pub struct Store {
    costs: StoreCosts,
    station: Station,
    link: Station,
}

impl Store {
    pub fn new(costs: StoreCosts) -> Store {
        Store { station: Station::new(costs.servers), link: Station::new(1), costs }
    }

    /// Begins an operation on `bytes`, and returns when it is done.
    pub fn serve(&mut self, operation: Operation, bytes: u64, now_ns: u64) -> u64 {
        let work_ns = match operation {
            Operation::Put => self.costs.put_ns,
            Operation::Get => self.costs.get_ns,
            Operation::Head => self.costs.head_ns,
        };
        self.serve_for(work_ns, bytes, now_ns)
    }

    /// Lists `objects`, by pages of a thousand.
    pub fn list(&mut self, objects: u64, now_ns: u64) -> u64 {
        self.serve_for(self.costs.head_ns * objects.div_ceil(10).max(1), 100 * objects, now_ns)
    }

    fn serve_for(&mut self, work_ns: u64, bytes: u64, now_ns: u64) -> u64 {
        let done_ns = self.station.serve(now_ns, work_ns);
        let sent_ns = match bytes {
            0 => now_ns,
            _ => self.link.serve(now_ns, (bytes as f64 / self.costs.bytes_per_s * 1e9) as u64),
        };
        done_ns.max(sent_ns) + self.costs.trip_ns
    }

    pub fn busy_ns(&self, now_ns: u64) -> (u64, u64) {
        (self.station.busy_ns(now_ns), self.link.busy_ns(now_ns))
    }

    pub fn operations(&self) -> u64 {
        self.station.served()
    }
}

/// Work on shared cores.
#[derive(Clone, Copy, Debug)]
pub enum Task {
    Draw(Name),
    Keep { film: usize, frame: u64 },
}

/// Cores that everything runs on, if there are such.
#[derive(Debug)]
pub struct Machine {
    cores: Option<(Cores, f64)>,
    tasks: BTreeMap<u64, Task>,
    next: u64,
    /// Number of the latest look at the cores; earlier ones are void.
    look: u64,
}

impl Machine {
    pub fn new(cores: Option<f64>) -> Machine {
        let cores = cores.map(|cores| (Cores::new(cores), cores));
        Machine { cores, tasks: BTreeMap::new(), next: 0, look: 0 }
    }

    /// Returns the tasks that are finished; `None` if another look was added since this one.
    pub fn due(&mut self, look: u64, now_ns: u64) -> Option<Vec<Task>> {
        let (cores, _) = self.cores.as_mut().filter(|_| look == self.look)?;
        Some(cores.finished(now_ns).iter().filter_map(|id| self.tasks.remove(id)).collect())
    }

    /// Stops what a worker draws.
    pub fn stop(&mut self, name: Name, now_ns: u64) {
        let is_its = |task: &Task| matches!(task, Task::Draw(other) if *other == name);
        let its = self.tasks.iter().filter(|(_, task)| is_its(task));
        let gone: Vec<u64> = its.map(|(id, _)| *id).collect();
        self.tasks.retain(|id, _| !gone.contains(id));
        if let Some((cores, _)) = &mut self.cores {
            for id in gone {
                cores.stop(now_ns, id);
            }
        }
    }
}

impl World {
    /// Begins work on the shared cores. Returns false if there are none.
    pub fn on_cores(&mut self, task: Task, work_ns: u64) -> bool {
        let now_ns = self.now_ns();
        let Some((cores, count)) = &mut self.machine.cores else { return false };
        let most = match task {
            Task::Draw(_) => *count,
            Task::Keep { .. } => 1.0,
        };
        self.machine.next += 1;
        let id = self.machine.next;
        cores.begin(now_ns, id, work_ns, most);
        self.machine.tasks.insert(id, task);
        self.look_at_cores();
        true
    }

    /// Adds the event of the next finished task.
    pub fn look_at_cores(&mut self) {
        let Some((cores, _)) = &self.machine.cores else { return };
        if let Some(at_ns) = cores.next_ns() {
            self.machine.look += 1;
            let number = self.machine.look;
            self.events.add(at_ns, Event::CoresDue { number });
        }
    }
}
