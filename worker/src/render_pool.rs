//! Threads that render units, one unit per thread at a time. A unit that panics fails alone.

use crate::renderer::{PreparedScene, Rendered, render};
use bytes::Bytes;
use farm_film::{LEAF_SAMPLES, SampleBlock, WorkUnit};
use farm_image::{PartialHeader, encode_partial};
use farm_job::{Digest, LeaseId};
use farm_proto::convert::{Grant, UnitResult};
use rustix::time::{ClockId, clock_gettime};
use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::UnboundedSender;
use tracing::{debug, info};

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
    /// Whether to go on.
    pub stop: Arc<Stop>,
}

/// Tells a thread to stop; once told it stays so.
#[derive(Debug, Default)]
pub struct Stop(AtomicU8);

impl Stop {
    const DROP: u8 = 1;
    const HAND_BACK: u8 = 2;

    /// Nobody wants the unit any more.
    pub fn drop_it(&self) {
        self.0.store(Self::DROP, Ordering::Relaxed);
    }

    /// There is no more time, but what is finished is wanted.
    pub fn hand_back(&self) {
        // What is to be dropped stays so.
        let _ = self.0.compare_exchange(0, Self::HAND_BACK, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Whether it was told.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0
    }

    /// Whether it was told to hand back what is finished.
    pub fn is_hand_back(&self) -> bool {
        self.0.load(Ordering::Relaxed) == Self::HAND_BACK
    }
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

/// Renders units, several at a time.
pub trait Pool: Send + Sync {
    /// Takes a unit, to be begun as soon as a slot is free.
    fn push(&self, assignment: Assignment);
}

/// Makes a pool of so many slots that says how each unit ended.
pub type MakePool =
    Arc<dyn Fn(usize, UnboundedSender<Ended>) -> std::io::Result<Box<dyn Pool>> + Send + Sync>;

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
    /// Pools of threads.
    pub fn maker() -> MakePool {
        Arc::new(|threads, ended| Ok(Box::new(Self::start(threads, &ended)?)))
    }

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
}

impl Pool for RenderPool {
    fn push(&self, assignment: Assignment) {
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
pub fn run(assignment: &Assignment) -> Ended {
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
    let finished = render_leaves(&frame.prepared, &grant.unit, stop);
    let whole = finished.first().is_some_and(|node| node.tile.block() == grant.unit.block);
    let rendered = finished.into_iter().next().filter(|_| whole || stop.is_hand_back())?;
    if !whole {
        info!(unit = %grant.unit, finished = %rendered.tile.block(), "time is up; what is finished of a unit is handed back");
    }
    let header = PartialHeader { counters: rendered.counters, ..frame.header.clone() };
    let partial_exr = Bytes::from(encode_partial(&rendered.tile, &header));
    Some(UnitResult {
        lease: grant.lease,
        job: grant.job,
        unit: WorkUnit { block: rendered.tile.block(), ..grant.unit },
        digest: Digest(*blake3::hash(&partial_exr).as_bytes()),
        partial_exr,
        render: begun.elapsed(),
        cpu: thread_cpu().saturating_sub(cpu_begun),
        counters: rendered.counters,
    })
}

/// Renders a unit leaf by leaf until it is finished or told to stop: nodes of the merge tree from the first sample on, the
/// largest first.
fn render_leaves(scene: &PreparedScene, unit: &WorkUnit, stop: &Stop) -> Vec<Rendered> {
    let mut finished: Vec<Rendered> = Vec::new();
    let mut start = unit.block.start();
    while start < unit.block.end() {
        let end = unit.block.end().min(start + LEAF_SAMPLES);
        let leaf = SampleBlock::new(start..end).expect("a block is made of leaves");
        let Some(mut node) = render(scene, unit.tile, leaf, &|| stop.is_set()) else { break };
        while let Some(left) = finished.pop_if(|left| left.tile.block().sibling() == Some(node.tile.block()))
        {
            let counters = left.counters.plus(node.counters);
            node = Rendered { tile: left.tile.merge(node.tile), counters };
        }
        finished.push(node);
        start = end;
    }
    finished
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
