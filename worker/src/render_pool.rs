//! Threads that render units, one unit per thread at a time. A unit that panics fails alone.

use crate::renderer::{PreparedScene, render};
use bytes::Bytes;
use farm_image::{PartialHeader, encode_partial};
use farm_job::{Digest, LeaseId};
use farm_proto::convert::{Grant, UnitResult};
use rustix::time::{ClockId, clock_gettime};
use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::UnboundedSender;
use tracing::debug;

/// A frame that is ready to trace, and what its partials say of themselves.
pub struct ReadyFrame {
    /// For the renderer.
    pub prepared: PreparedScene,
    /// Of every partial; the counters are the unit's.
    pub header: PartialHeader,
}

/// A unit on its way to a thread.
pub struct Assignment {
    /// What to render.
    pub grant: Grant,
    /// What it shows.
    pub frame: Arc<ReadyFrame>,
    /// Set when nobody wants it any more.
    pub stop: Arc<AtomicBool>,
}

/// How a unit ended. There are never more of these than threads.
#[derive(Debug)]
pub enum Ended {
    /// With a result.
    Rendered(Box<UnitResult>),
    /// Because it was told to stop.
    Stopped(LeaseId),
    /// With a fault.
    Failed(LeaseId, String),
}

/// The threads. Dropping the pool lets each finish its unit, unless that is told to stop.
pub struct RenderPool {
    queue: Arc<Queue>,
}

#[derive(Default)]
struct Queue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Default)]
struct QueueState {
    waiting: VecDeque<Assignment>,
    closed: bool,
}

impl RenderPool {
    /// Starts `threads` threads that report to `ended`.
    pub fn start(threads: usize, ended: &UnboundedSender<Ended>) -> std::io::Result<Self> {
        let queue = Arc::new(Queue::default());
        for index in 0..threads {
            let (queue, ended) = (queue.clone(), ended.clone());
            std::thread::Builder::new().name(format!("render-{index}")).spawn(move || {
                let mut idle_since = Instant::now();
                while let Some(assignment) = queue.next() {
                    debug!(lease = %assignment.grant.lease, idle = ?idle_since.elapsed(), "unit begins");
                    let end = run(&assignment);
                    idle_since = Instant::now();
                    // Nobody listens any more: the worker is gone.
                    if ended.send(end).is_err() {
                        break;
                    }
                }
            })?;
        }
        Ok(Self { queue })
    }

    /// Hands a unit to the next free thread.
    pub fn push(&self, assignment: Assignment) {
        self.queue.lock().waiting.push_back(assignment);
        self.queue.changed.notify_one();
    }
}

impl Drop for RenderPool {
    fn drop(&mut self) {
        self.queue.lock().closed = true;
        self.queue.changed.notify_all();
    }
}

impl Queue {
    fn lock(&self) -> std::sync::MutexGuard<'_, QueueState> {
        // No code that can panic runs under this lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self) -> Option<Assignment> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(assignment) = state.waiting.pop_front() {
                return Some(assignment);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// Renders one unit; whatever goes wrong in it stays in it.
fn run(assignment: &Assignment) -> Ended {
    let lease = assignment.grant.lease;
    match catch_unwind(AssertUnwindSafe(|| render_unit(assignment))) {
        Ok(Some(result)) => Ended::Rendered(Box::new(result)),
        Ok(None) => Ended::Stopped(lease),
        Err(panic) => Ended::Failed(lease, panic_text(panic.as_ref())),
    }
}

fn render_unit(assignment: &Assignment) -> Option<UnitResult> {
    let Assignment { grant, frame, stop } = assignment;
    let (begun, cpu_begun) = (Instant::now(), thread_cpu());
    let stop = || stop.load(Ordering::Relaxed);
    let rendered = render(&frame.prepared, grant.unit.tile, grant.unit.block, &stop)?;
    let header = PartialHeader { counters: rendered.counters, ..frame.header.clone() };
    let partial_exr = Bytes::from(encode_partial(&rendered.tile, &header));
    Some(UnitResult {
        lease: grant.lease,
        job: grant.job,
        unit: grant.unit,
        digest: Digest(*blake3::hash(&partial_exr).as_bytes()),
        partial_exr,
        render: begun.elapsed(),
        cpu: thread_cpu().saturating_sub(cpu_begun),
        counters: rendered.counters,
    })
}

/// Processor time of this thread.
fn thread_cpu() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}

/// What a panic said.
pub fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| panic.downcast_ref::<String>().cloned());
    format!("the renderer panicked: {}", text.as_deref().unwrap_or("no reason given"))
}
