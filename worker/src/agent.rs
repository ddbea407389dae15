//! What a worker does next: events in, actions out. Reads no clock, socket or file.
//!
//! ```text
//! granted -> waiting --(frame ready, slot free)--> running --> finished --(settled)--> gone
//!               |                                     |            |
//!               +-- revoked, link lost: gone          |            +-- link lost: kept, delivered to the next link
//!               +-- draining: returned                +-- failed: reported; stopped: gone, or returned when time is up
//! ```
//!
//! A frame has to be prepared before its units can be rendered. Only a few prepared frames fit into memory: those that
//! units need stay, of the others the longest unused goes first.

use farm_film::FrameIndex;
use farm_job::{JobId, LeaseId};
use farm_proto::convert::Grant;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Prepared frames that are kept: the one being rendered, and the next one, so that there is no pause between frames. Only one
/// where memory is short.
const FRAMES_MAX: usize = 2;

/// One frame of one job, as far as a worker has to prepare it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameKey {
    /// Whose.
    pub job: JobId,
    /// Which.
    pub frame: FrameIndex,
}

impl From<&Grant> for FrameKey {
    fn from(grant: &Grant) -> Self {
        Self { job: grant.job, frame: grant.unit.frame }
    }
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A coordinator has taken the worker in. Under another session than before, everything held is worthless.
    Welcomed {
        /// Names the coordinator's life.
        session: u64,
    },
    /// The connection is gone.
    Disconnected,
    /// A unit to render.
    Granted(Grant),
    /// A unit that is no longer wanted.
    Revoked(LeaseId),
    /// A result arrived at its place, or is not wanted.
    Settled(LeaseId),
    /// A frame is ready to trace.
    Prepared(FrameKey),
    /// A frame cannot be made ready.
    PrepareFailed(FrameKey, String),
    /// A frame needs more than this worker has: it is not for the likes of it.
    TooLarge(FrameKey, String),
    /// Two frames like those at hand do not fit into memory at once.
    MemoryShort,
    /// A unit is rendered.
    Rendered(LeaseId),
    /// A unit was stopped.
    Stopped(LeaseId),
    /// A unit cannot be rendered.
    Failed(LeaseId, String),
    /// Finish what is running, hand back the rest, and leave.
    Drain,
    /// Draining has taken long enough: hand back what is running as well, as far as it is.
    TimeIsUp,
}

/// What to do now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Make a frame ready.
    Prepare(FrameKey),
    /// Let go of a frame's memory.
    Forget(FrameKey),
    /// Render a unit.
    Start(Grant),
    /// Stop rendering a unit.
    Stop(LeaseId),
    /// Stop rendering a unit; what is finished of it is its result.
    HandBack(LeaseId),
    /// Send a result.
    Deliver(LeaseId),
    /// Throw a result away.
    Discard(LeaseId),
    /// Say that a unit cannot be rendered.
    Report(LeaseId, String),
    /// Give a unit back.
    Return(LeaseId),
    /// Say that a job is beyond this worker.
    Refuse(JobId, String),
    /// Say that no more units are wanted.
    AnnounceDraining,
    /// All is done: leave.
    Leave,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FrameState {
    Preparing,
    Ready,
}

/// The mind of a worker.
#[derive(Debug)]
pub struct Agent {
    slots: usize,
    session: Option<u64>,
    connected: bool,
    draining: bool,
    time_is_up: bool,
    left: bool,
    frames_max: usize,
    /// Jobs beyond this worker, and why.
    refused: BTreeMap<JobId, String>,
    waiting: VecDeque<Grant>,
    running: BTreeMap<LeaseId, Grant>,
    finished: BTreeSet<LeaseId>,
    /// Least recently used first.
    frames: Vec<(FrameKey, FrameState)>,
    actions: VecDeque<Action>,
}

impl Agent {
    /// A worker that renders `slots` units at once.
    pub fn new(slots: usize) -> Self {
        assert!(slots > 0, "a worker renders at least one unit at a time");
        Self {
            slots,
            session: None,
            connected: false,
            draining: false,
            time_is_up: false,
            left: false,
            frames_max: FRAMES_MAX,
            refused: BTreeMap::new(),
            waiting: VecDeque::new(),
            running: BTreeMap::new(),
            finished: BTreeSet::new(),
            frames: Vec::new(),
            actions: VecDeque::new(),
        }
    }

    /// Takes notice of an event.
    pub fn handle(&mut self, event: Event) {
        match event {
            Event::Welcomed { session } => self.welcomed(session),
            Event::Disconnected => {
                self.connected = false;
                self.waiting.clear();
            }
            Event::Granted(grant) => self.granted(grant),
            Event::Revoked(lease) => self.revoked(lease),
            Event::Settled(lease) => {
                if self.finished.remove(&lease) {
                    self.act(Action::Discard(lease));
                }
            }
            Event::Prepared(key) => self.prepared(key),
            Event::PrepareFailed(key, reason) => self.prepare_failed(key, &reason),
            Event::TooLarge(key, reason) => self.too_large(key, reason),
            Event::MemoryShort => self.frames_max = 1,
            Event::Rendered(lease) => self.rendered(lease),
            Event::Stopped(lease) => {
                if self.running.remove(&lease).is_some() && self.time_is_up && self.connected {
                    self.act(Action::Return(lease));
                }
            }
            Event::Failed(lease, reason) => {
                if self.running.remove(&lease).is_some() {
                    self.act(Action::Report(lease, reason));
                }
            }
            Event::Drain => self.drain(),
            Event::TimeIsUp => {
                self.time_is_up = true;
                for lease in self.running.keys().copied().collect::<Vec<_>>() {
                    self.act(Action::HandBack(lease));
                }
            }
        }
        self.go_on();
    }

    /// The next thing to do; none when all is done.
    pub fn poll_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// Every lease that is held: waiting, running, or rendered and not yet settled.
    pub fn leases(&self) -> Vec<LeaseId> {
        let waiting = self.waiting.iter().map(|grant| grant.lease);
        waiting.chain(self.running.keys().copied()).chain(self.finished.iter().copied()).collect()
    }

    fn act(&mut self, action: Action) {
        self.actions.push_back(action);
    }

    fn welcomed(&mut self, session: u64) {
        self.connected = true;
        if self.session.replace(session).is_some_and(|before| before != session) {
            self.start_afresh();
        }
        if self.draining {
            self.act(Action::AnnounceDraining);
        }
        for lease in self.finished.clone() {
            self.act(Action::Deliver(lease));
        }
    }

    /// Another coordinator: the same numbers now mean other jobs.
    fn start_afresh(&mut self) {
        self.refused.clear();
        for lease in std::mem::take(&mut self.finished) {
            self.act(Action::Discard(lease));
        }
        for lease in self.running.keys().copied().collect::<Vec<_>>() {
            self.act(Action::Stop(lease));
        }
        for (key, _) in std::mem::take(&mut self.frames) {
            self.act(Action::Forget(key));
        }
    }

    fn granted(&mut self, grant: Grant) {
        if self.draining {
            self.act(Action::Return(grant.lease));
        } else if let Some(reason) = self.refused.get(&grant.job) {
            self.act(Action::Refuse(grant.job, reason.clone()));
        } else {
            self.waiting.push_back(grant);
        }
    }

    /// Nothing of the job is given out again to this connection; the leases end with the refusal.
    fn too_large(&mut self, key: FrameKey, reason: String) {
        self.frames.retain(|(held, _)| *held != key);
        self.waiting.retain(|grant| grant.job != key.job);
        self.act(Action::Refuse(key.job, reason.clone()));
        self.refused.insert(key.job, reason);
    }

    fn revoked(&mut self, lease: LeaseId) {
        self.waiting.retain(|grant| grant.lease != lease);
        if self.running.contains_key(&lease) {
            self.act(Action::Stop(lease));
        }
    }

    fn prepared(&mut self, key: FrameKey) {
        match self.frames.iter_mut().find(|(held, _)| *held == key) {
            Some((_, state)) => *state = FrameState::Ready,
            // It was given up while it was being prepared.
            None => self.act(Action::Forget(key)),
        }
    }

    fn prepare_failed(&mut self, key: FrameKey, reason: &str) {
        self.frames.retain(|(held, _)| *held != key);
        let (failed, waiting) = self.waiting.drain(..).partition(|grant| FrameKey::from(grant) == key);
        self.waiting = waiting;
        let failed: VecDeque<Grant> = failed;
        for grant in failed {
            self.act(Action::Report(grant.lease, reason.to_owned()));
        }
    }

    fn rendered(&mut self, lease: LeaseId) {
        if self.running.remove(&lease).is_none() {
            self.act(Action::Discard(lease));
            return;
        }
        self.finished.insert(lease);
        if self.connected {
            self.act(Action::Deliver(lease));
        }
    }

    fn drain(&mut self) {
        if self.draining {
            return;
        }
        self.draining = true;
        for grant in std::mem::take(&mut self.waiting) {
            self.act(Action::Return(grant.lease));
        }
        if self.connected {
            self.act(Action::AnnounceDraining);
        }
    }

    /// Fills free slots, prepares what is waited for, leaves when drained.
    fn go_on(&mut self) {
        self.start_units();
        self.prepare_next();
        // Without a connection nothing can be delivered, and nobody knows whether there will be one again.
        let nothing_left = self.running.is_empty() && (self.finished.is_empty() || !self.connected);
        if self.draining && nothing_left && !self.left {
            self.left = true;
            self.act(Action::Leave);
        }
    }

    fn start_units(&mut self) {
        while self.running.len() < self.slots {
            let ready = |grant: &Grant| {
                self.frames.iter().any(|held| *held == (FrameKey::from(grant), FrameState::Ready))
            };
            let Some(place) = self.waiting.iter().position(ready) else { break };
            let grant = self.waiting.remove(place).expect("the position was just found");
            self.touch(FrameKey::from(&grant));
            self.running.insert(grant.lease, grant);
            self.act(Action::Start(grant));
        }
    }

    /// Moves a frame to the end of the list: most recently used.
    fn touch(&mut self, key: FrameKey) {
        if let Some(place) = self.frames.iter().position(|(held, _)| *held == key) {
            let frame = self.frames.remove(place);
            self.frames.push(frame);
        }
    }

    /// One frame at a time is prepared, in the order in which units wait for them.
    fn prepare_next(&mut self) {
        if self.frames.iter().any(|(_, state)| *state == FrameState::Preparing) {
            return;
        }
        let held = |key: FrameKey| self.frames.iter().any(|(held, _)| *held == key);
        let Some(key) = self.waiting.iter().map(FrameKey::from).find(|key| !held(*key)) else { return };
        if self.frames.len() >= self.frames_max && !self.make_room() {
            return;
        }
        self.frames.push((key, FrameState::Preparing));
        self.act(Action::Prepare(key));
    }

    /// Lets go of the longest unused frame that no unit needs.
    fn make_room(&mut self) -> bool {
        let units = || self.waiting.iter().chain(self.running.values());
        let unneeded = |key: FrameKey| units().all(|grant| FrameKey::from(grant) != key);
        let Some(place) = self.frames.iter().position(|(key, _)| unneeded(*key)) else { return false };
        let (key, _) = self.frames.remove(place);
        self.act(Action::Forget(key));
        true
    }
}

#[cfg(test)]
#[path = "agent_tests.rs"]
mod tests;
