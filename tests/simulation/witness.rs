//! A host that speaks the protocol by itself. It renders what it is granted, notes which of it the coordinator acknowledges,
//! and is no pleasant company: it also sends what others have sent, in any order, again, late, damaged or not, as its own.

use crate::coordinator::Seen;
use crate::faults::Dice;
use crate::network::{Cable, dialer};
use crate::picture::rendered;
use farm_film::WorkUnit;
use farm_job::LeaseId;
use farm_proto::PROTOCOL_VERSION;
use farm_proto::convert::{FromWorker, Grant, Heartbeat, Hello, ToWorker, UnitResult};
use farm_worker::link::{LinkEvent, Target, Up, keep_connected};
use farm_worker::renderer::FINGERPRINT;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::mpsc;

/// Its host.
pub const WITNESS: &str = "witness";

/// Between two things that it says; a unit takes as long.
const PAUSE: Duration = Duration::from_millis(400);

/// Percent of what it says that others have said before.
const REPEATS: u64 = 40;

/// What has been said by anyone.
pub type Sayings = Arc<Mutex<Vec<UnitResult>>>;

/// One connection.
struct Talk {
    up: Up,
    grants: VecDeque<Grant>,
    /// What was sent, and by which lease.
    sent: BTreeMap<LeaseId, WorkUnit>,
}

/// Talks whenever there is somebody to talk to, until its host dies.
pub async fn live(sayings: Sayings, seen: Arc<Mutex<Seen>>, seed: u64) -> turmoil::Result {
    let (sender, mut events) = mpsc::channel(64);
    let hello = Hello {
        protocol: PROTOCOL_VERSION,
        name: WITNESS.to_owned(),
        slots: 1,
        fingerprint: FINGERPRINT.to_owned(),
    };
    tokio::spawn(keep_connected(
        Target::Memory(dialer(Arc::new(Cable::new(seed)))),
        hello,
        Duration::from_secs(3600),
        sender,
    ));
    let mut dice = Dice::new(seed);
    let mut talk: Option<Talk> = None;
    let mut pause = tokio::time::interval(PAUSE);
    loop {
        tokio::select! {
            biased;
            event = events.recv() => match event {
                Some(LinkEvent::Up(up)) => {
                    talk = Some(Talk { up, grants: VecDeque::new(), sent: BTreeMap::new() });
                }
                Some(LinkEvent::Message(message)) => {
                    if let Some(talk) = &mut talk {
                        talk.hear(message, &seen);
                    }
                }
                Some(LinkEvent::Down { .. }) => talk = None,
                Some(LinkEvent::Ended(error)) => return Err(error.into()),
                None => return Ok(()),
            },
            _ = pause.tick() => if let Some(talk) = &mut talk {
                talk.speak(&sayings, &mut dice);
            },
        }
    }
}

impl Talk {
    fn hear(&mut self, message: ToWorker, seen: &Mutex<Seen>) {
        match message {
            ToWorker::Grant(grant) => self.grants.push_back(grant),
            ToWorker::Revoke(lease) => self.grants.retain(|grant| grant.lease != lease),
            ToWorker::Ack(lease) => {
                if let Some(unit) = self.sent.get(&lease) {
                    seen.lock().expect("nothing panics in here").acknowledged(*unit);
                }
            }
            _ => {}
        }
    }

    fn speak(&mut self, sayings: &Sayings, dice: &mut Dice) {
        let held = self.grants.iter().map(|grant| grant.lease).collect();
        let beat = Heartbeat { worker: self.up.worker, leases: held, round_trip: None };
        let client = self.up.client.clone();
        tokio::spawn(async move { client.beat(beat).await });
        let word = match self.grants.pop_front() {
            Some(grant) if !dice.percent(REPEATS) => Some(rendered(&grant)),
            Some(grant) => {
                self.grants.push_front(grant);
                pick(sayings, dice)
            }
            None => pick(sayings, dice),
        };
        if let Some(word) = word {
            self.sent.insert(word.lease, word.unit);
            // Where there is no room for it, it is lost.
            let _ = self.up.outgoing.try_send(FromWorker::Result(word));
        }
    }
}

fn pick(sayings: &Sayings, dice: &mut Dice) -> Option<UnitResult> {
    let sayings = sayings.lock().expect("nothing panics in here");
    (!sayings.is_empty()).then(|| sayings[dice.roll(sayings.len() as u64) as usize].clone())
}
