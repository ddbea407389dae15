//! The messages of the work stream.

use super::{ConvertError, seconds, text};
use crate::v1;
use bytes::Bytes;
use farm_film::{Counters, FrameIndex, WorkUnit};
use farm_job::{Digest, JobId, LeaseId, WorkerId};
use std::time::Duration;
use v1::coordinator_message::Message as ToWorkerMessage;
use v1::worker_message::Message as FromWorkerMessage;

/// Most units that one worker may claim to render at a time; more is a mistake or an attack.
const SLOTS_MAX: u32 = 4096;

/// A worker introduces itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Protocol version.
    pub protocol: u32,
    /// For people.
    pub name: String,
    /// Units rendered at the same time, >= 1.
    pub slots: u32,
    /// Of the renderer.
    pub fingerprint: String,
}

/// A rendered unit on its way.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitResult {
    /// Under which lease.
    pub lease: LeaseId,
    /// Of which job.
    pub job: JobId,
    /// What was rendered.
    pub unit: WorkUnit,
    /// Of `partial_exr`, as the worker computed it.
    pub digest: Digest,
    /// Pixel sums.
    pub partial_exr: Bytes,
    /// From begin to end of the unit.
    pub render: Duration,
    /// Processor time of the unit.
    pub cpu: Duration,
    /// What was traced.
    pub counters: Counters,
}

/// One claim on one unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grant {
    /// Its name.
    pub lease: LeaseId,
    /// Of which job.
    pub job: JobId,
    /// What to render.
    pub unit: WorkUnit,
    /// 1 for the first try of this unit.
    pub attempt: u32,
    /// Until the lease runs out.
    pub ttl: Duration,
}

/// A sign of life.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Whose.
    pub worker: WorkerId,
    /// Leases held: waiting, rendered or not yet acknowledged.
    pub leases: Vec<LeaseId>,
    /// Of the latest heartbeat that was heard.
    pub round_trip: Option<Duration>,
}

/// What a worker says.
#[derive(Clone, Debug, PartialEq)]
pub enum FromWorker {
    /// First of all.
    Hello(Hello),
    /// A unit is rendered.
    Result(UnitResult),
    /// A unit cannot be rendered here.
    UnitFailed {
        /// Which claim.
        lease: LeaseId,
        /// Why.
        reason: String,
    },
    /// A frame is ready to trace.
    Prepared {
        /// Of which job.
        job: JobId,
        /// Which.
        frame: FrameIndex,
        /// To get the scene.
        fetch: Duration,
        /// To build what rays need.
        build: Duration,
    },
    /// Takes no more units.
    Draining,
    /// A unit comes back unrendered.
    Returned(LeaseId),
    /// A job cannot be rendered here at all.
    JobRefused {
        /// Which one.
        job: JobId,
        /// Why.
        reason: String,
    },
}

/// What a worker hears.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToWorker {
    /// Taken in.
    Welcome {
        /// As whom.
        worker: WorkerId,
        /// How often to say that it lives.
        heartbeat: Duration,
        /// Names the coordinator's life.
        session: u64,
    },
    /// Render this.
    Grant(Grant),
    /// Do not render this any more.
    Revoke(LeaseId),
    /// The result is safe.
    Ack(LeaseId),
    /// The result is not wanted.
    Reject {
        /// Of which claim.
        lease: LeaseId,
        /// Why.
        reason: String,
    },
    /// Nothing is outstanding.
    Drained,
    /// The coordinator ends.
    Farewell(String),
}

/// Cuts a reason to what the other side accepts.
fn shortened(mut reason: String) -> String {
    let mut end = reason.len().min(super::TEXT_BYTES_MAX);
    while !reason.is_char_boundary(end) {
        end -= 1;
    }
    reason.truncate(end);
    reason
}

impl From<FromWorker> for v1::WorkerMessage {
    fn from(message: FromWorker) -> Self {
        let message = match message {
            FromWorker::Hello(hello) => FromWorkerMessage::Hello(v1::Hello {
                protocol: hello.protocol,
                name: hello.name,
                slots: hello.slots,
                fingerprint: hello.fingerprint,
            }),
            FromWorker::Result(result) => FromWorkerMessage::Result(v1::Result {
                lease: result.lease.0,
                job: result.job.0,
                unit: Some(result.unit.into()),
                digest: Some(result.digest.into()),
                partial_exr: result.partial_exr,
                render_seconds: result.render.as_secs_f64(),
                cpu_seconds: result.cpu.as_secs_f64(),
                counters: Some(result.counters.into()),
            }),
            FromWorker::UnitFailed { lease, reason } => {
                FromWorkerMessage::UnitFailed(v1::UnitFailed { lease: lease.0, reason: shortened(reason) })
            }
            FromWorker::Prepared { job, frame, fetch, build } => FromWorkerMessage::Prepared(v1::Prepared {
                job: job.0,
                frame: frame.0,
                fetch_seconds: fetch.as_secs_f64(),
                build_seconds: build.as_secs_f64(),
            }),
            FromWorker::Draining => FromWorkerMessage::Draining(v1::Draining {}),
            FromWorker::Returned(lease) => FromWorkerMessage::Returned(v1::Returned { lease: lease.0 }),
            FromWorker::JobRefused { job, reason } => {
                FromWorkerMessage::JobRefused(v1::JobRefused { job: job.0, reason: shortened(reason) })
            }
        };
        Self { message: Some(message) }
    }
}

impl TryFrom<v1::WorkerMessage> for FromWorker {
    type Error = ConvertError;

    fn try_from(wire: v1::WorkerMessage) -> Result<Self, ConvertError> {
        Ok(match wire.message.ok_or(ConvertError::Missing("content"))? {
            FromWorkerMessage::Hello(hello) => Self::Hello(hello.try_into()?),
            FromWorkerMessage::Result(result) => Self::Result(result.try_into()?),
            FromWorkerMessage::UnitFailed(failed) => {
                Self::UnitFailed { lease: LeaseId(failed.lease), reason: text("reason", failed.reason)? }
            }
            FromWorkerMessage::Prepared(prepared) => Self::Prepared {
                job: JobId(prepared.job),
                frame: FrameIndex(prepared.frame),
                fetch: seconds("fetch time", prepared.fetch_seconds)?,
                build: seconds("build time", prepared.build_seconds)?,
            },
            FromWorkerMessage::Draining(v1::Draining {}) => Self::Draining,
            FromWorkerMessage::Returned(returned) => Self::Returned(LeaseId(returned.lease)),
            FromWorkerMessage::JobRefused(refused) => {
                Self::JobRefused { job: JobId(refused.job), reason: text("reason", refused.reason)? }
            }
        })
    }
}

impl From<Heartbeat> for v1::Heartbeat {
    fn from(beat: Heartbeat) -> Self {
        Self {
            worker: beat.worker.0,
            leases: beat.leases.into_iter().map(|lease| lease.0).collect(),
            round_trip_us: beat.round_trip.map(|time| u64::try_from(time.as_micros()).unwrap_or(u64::MAX)),
        }
    }
}

impl From<v1::Heartbeat> for Heartbeat {
    fn from(beat: v1::Heartbeat) -> Self {
        Self {
            worker: WorkerId(beat.worker),
            leases: beat.leases.into_iter().map(LeaseId).collect(),
            round_trip: beat.round_trip_us.map(Duration::from_micros),
        }
    }
}

impl TryFrom<v1::Hello> for Hello {
    type Error = ConvertError;

    fn try_from(hello: v1::Hello) -> Result<Self, ConvertError> {
        if !(1..=SLOTS_MAX).contains(&hello.slots) {
            return Err(ConvertError::Number { what: "number of slots", value: f64::from(hello.slots) });
        }
        Ok(Self {
            protocol: hello.protocol,
            name: text("worker name", hello.name)?,
            slots: hello.slots,
            fingerprint: text("fingerprint", hello.fingerprint)?,
        })
    }
}

impl TryFrom<v1::Result> for UnitResult {
    type Error = ConvertError;

    fn try_from(result: v1::Result) -> Result<Self, ConvertError> {
        Ok(Self {
            lease: LeaseId(result.lease),
            job: JobId(result.job),
            unit: result.unit.ok_or(ConvertError::Missing("unit"))?.try_into()?,
            digest: result.digest.ok_or(ConvertError::Missing("digest"))?.try_into()?,
            partial_exr: result.partial_exr,
            render: seconds("render time", result.render_seconds)?,
            cpu: seconds("processor time", result.cpu_seconds)?,
            counters: result.counters.unwrap_or_default().into(),
        })
    }
}

impl From<ToWorker> for v1::CoordinatorMessage {
    fn from(message: ToWorker) -> Self {
        let message = match message {
            ToWorker::Welcome { worker, heartbeat, session } => ToWorkerMessage::Welcome(v1::Welcome {
                worker: worker.0,
                heartbeat_ms: u32::try_from(heartbeat.as_millis()).unwrap_or(u32::MAX),
                session,
            }),
            ToWorker::Grant(grant) => ToWorkerMessage::Grant(v1::Grant {
                lease: grant.lease.0,
                job: grant.job.0,
                unit: Some(grant.unit.into()),
                attempt: grant.attempt,
                ttl_ms: u64::try_from(grant.ttl.as_millis()).unwrap_or(u64::MAX),
            }),
            ToWorker::Revoke(lease) => ToWorkerMessage::Revoke(v1::Revoke { lease: lease.0 }),
            ToWorker::Ack(lease) => ToWorkerMessage::Ack(v1::Ack { lease: lease.0 }),
            ToWorker::Reject { lease, reason } => {
                ToWorkerMessage::Reject(v1::Reject { lease: lease.0, reason: shortened(reason) })
            }
            ToWorker::Drained => ToWorkerMessage::Drained(v1::Drained {}),
            ToWorker::Farewell(reason) => {
                ToWorkerMessage::Farewell(v1::Farewell { reason: shortened(reason) })
            }
        };
        Self { message: Some(message) }
    }
}

impl TryFrom<v1::CoordinatorMessage> for ToWorker {
    type Error = ConvertError;

    fn try_from(wire: v1::CoordinatorMessage) -> Result<Self, ConvertError> {
        Ok(match wire.message.ok_or(ConvertError::Missing("content"))? {
            ToWorkerMessage::Welcome(welcome) => Self::Welcome {
                worker: WorkerId(welcome.worker),
                // A heartbeat without pause would be a flood.
                heartbeat: Duration::from_millis(u64::from(welcome.heartbeat_ms.max(10))),
                session: welcome.session,
            },
            ToWorkerMessage::Grant(grant) => Self::Grant(Grant {
                lease: LeaseId(grant.lease),
                job: JobId(grant.job),
                unit: grant.unit.ok_or(ConvertError::Missing("unit"))?.try_into()?,
                attempt: grant.attempt,
                ttl: Duration::from_millis(grant.ttl_ms),
            }),
            ToWorkerMessage::Revoke(revoke) => Self::Revoke(LeaseId(revoke.lease)),
            ToWorkerMessage::Ack(ack) => Self::Ack(LeaseId(ack.lease)),
            ToWorkerMessage::Reject(reject) => {
                Self::Reject { lease: LeaseId(reject.lease), reason: text("reason", reject.reason)? }
            }
            ToWorkerMessage::Drained(v1::Drained {}) => Self::Drained,
            ToWorkerMessage::Farewell(farewell) => Self::Farewell(text("reason", farewell.reason)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use farm_film::{SampleBlock, Tile};

    fn unit() -> WorkUnit {
        WorkUnit {
            frame: FrameIndex(2),
            tile: Tile::new(0, 0, 8, 8).unwrap(),
            block: SampleBlock::new(0..16).unwrap(),
        }
    }

    #[test]
    fn what_a_worker_says_survives_the_journey() {
        let hello = Hello { protocol: 1, name: "spare".into(), slots: 4, fingerprint: "tessera 1".into() };
        let result = UnitResult {
            lease: LeaseId(5),
            job: JobId(1),
            unit: unit(),
            digest: Digest([1; 32]),
            partial_exr: Bytes::from_static(b"exr"),
            render: Duration::from_millis(250),
            cpu: Duration::from_millis(125),
            counters: Counters { samples: 1024, ..Counters::default() },
        };
        let messages = [
            FromWorker::Hello(hello),
            FromWorker::Returned(LeaseId(4)),
            FromWorker::JobRefused { job: JobId(2), reason: "needs 80 GB".into() },
            FromWorker::Result(result),
            FromWorker::UnitFailed { lease: LeaseId(5), reason: "out of memory".into() },
            FromWorker::Draining,
        ];
        for message in messages {
            assert_eq!(FromWorker::try_from(v1::WorkerMessage::from(message.clone())).unwrap(), message);
        }
    }

    #[test]
    fn a_heartbeat_survives_the_journey() {
        let beat = Heartbeat {
            worker: WorkerId(7),
            leases: vec![LeaseId(1), LeaseId(9)],
            round_trip: Some(Duration::from_micros(250)),
        };
        assert_eq!(Heartbeat::from(v1::Heartbeat::from(beat.clone())), beat);
    }

    #[test]
    fn what_a_worker_hears_survives_the_journey() {
        let grant = Grant {
            lease: LeaseId(5),
            job: JobId(1),
            unit: unit(),
            attempt: 2,
            ttl: Duration::from_secs(300),
        };
        let messages = [
            ToWorker::Welcome { worker: WorkerId(3), heartbeat: Duration::from_secs(1), session: 11 },
            ToWorker::Grant(grant),
            ToWorker::Revoke(LeaseId(5)),
            ToWorker::Ack(LeaseId(5)),
            ToWorker::Reject { lease: LeaseId(5), reason: "digest differs".into() },
            ToWorker::Drained,
            ToWorker::Farewell("all frames are done".into()),
        ];
        for message in messages {
            assert_eq!(ToWorker::try_from(v1::CoordinatorMessage::from(message.clone())).unwrap(), message);
        }
    }

    #[test]
    fn hostile_messages_are_refused() {
        assert!(FromWorker::try_from(v1::WorkerMessage { message: None }).is_err());
        let idle = v1::Hello { slots: 0, ..v1::Hello::default() };
        assert!(Hello::try_from(idle).is_err());
        let hello =
            FromWorker::Hello(Hello { protocol: 1, name: "x".into(), slots: 1, fingerprint: "f".into() });
        let mut wire = v1::WorkerMessage::from(hello);
        if let Some(FromWorkerMessage::Hello(hello)) = &mut wire.message {
            hello.name = "x".repeat(1 << 20);
        }
        assert!(FromWorker::try_from(wire).unwrap_err().to_string().contains("worker name"));
        for bad in [f64::NAN, -1.0, f64::INFINITY] {
            let prepared = v1::Prepared { build_seconds: bad, ..v1::Prepared::default() };
            let wire = v1::WorkerMessage { message: Some(FromWorkerMessage::Prepared(prepared)) };
            assert!(FromWorker::try_from(wire).is_err(), "{bad} seconds");
        }
    }

    #[test]
    fn a_long_reason_is_cut_at_a_character() {
        let failed = FromWorker::UnitFailed { lease: LeaseId(1), reason: "\u{fc}".repeat(5000) };
        assert!(FromWorker::try_from(v1::WorkerMessage::from(failed)).is_ok());
    }
}
