use super::*;
use farm_film::{SampleBlock, Tile, WorkUnit};
use std::time::Duration;

const SESSION: u64 = 1;

fn key(frame: u32) -> FrameKey {
    FrameKey { job: JobId(1), frame: FrameIndex(frame) }
}

fn grant(lease: u64, frame: u32) -> Grant {
    let unit = WorkUnit {
        frame: FrameIndex(frame),
        tile: Tile::new(0, 0, 8, 8).unwrap(),
        block: SampleBlock::new(0..16).unwrap(),
    };
    Grant { lease: LeaseId(lease), job: JobId(1), unit, attempt: 1, ttl: Duration::from_secs(4) }
}

/// Tells the agent and collects what it wants.
fn tell(agent: &mut Agent, event: Event) -> Vec<Action> {
    agent.handle(event);
    std::iter::from_fn(|| agent.poll_action()).collect()
}

/// A connected worker with frame 0 ready.
fn ready(slots: usize) -> Agent {
    let mut agent = Agent::new(slots);
    tell(&mut agent, Event::Welcomed { session: SESSION });
    assert_eq!(tell(&mut agent, Event::Granted(grant(100, 0))), [Action::Prepare(key(0))]);
    assert_eq!(tell(&mut agent, Event::Prepared(key(0))), [Action::Start(grant(100, 0))]);
    tell(&mut agent, Event::Rendered(LeaseId(100)));
    tell(&mut agent, Event::Settled(LeaseId(100)));
    assert!(agent.leases().is_empty());
    agent
}

#[test]
fn units_fill_the_slots_and_the_next_follows_at_once() {
    let mut agent = ready(2);
    assert_eq!(tell(&mut agent, Event::Granted(grant(1, 0))), [Action::Start(grant(1, 0))]);
    assert_eq!(tell(&mut agent, Event::Granted(grant(2, 0))), [Action::Start(grant(2, 0))]);
    assert_eq!(tell(&mut agent, Event::Granted(grant(3, 0))), []);
    let next = tell(&mut agent, Event::Rendered(LeaseId(1)));
    assert_eq!(next, [Action::Deliver(LeaseId(1)), Action::Start(grant(3, 0))]);
    assert_eq!(agent.leases(), [LeaseId(2), LeaseId(3), LeaseId(1)]);
}

#[test]
fn the_next_frame_is_prepared_while_this_one_renders() {
    let mut agent = ready(1);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    assert_eq!(tell(&mut agent, Event::Granted(grant(2, 1))), [Action::Prepare(key(1))]);
    assert_eq!(tell(&mut agent, Event::Prepared(key(1))), []);
    let next = tell(&mut agent, Event::Rendered(LeaseId(1)));
    assert_eq!(next, [Action::Deliver(LeaseId(1)), Action::Start(grant(2, 1))]);
    // A third frame pushes out the first, which nobody needs; never the one that renders.
    assert_eq!(
        tell(&mut agent, Event::Granted(grant(3, 2))),
        [Action::Forget(key(0)), Action::Prepare(key(2))]
    );
    assert_eq!(tell(&mut agent, Event::Prepared(key(2))), []);
    assert_eq!(tell(&mut agent, Event::Granted(grant(4, 3))), []);
    let next = tell(&mut agent, Event::Rendered(LeaseId(2)));
    let expected = [
        Action::Deliver(LeaseId(2)),
        Action::Start(grant(3, 2)),
        Action::Forget(key(1)),
        Action::Prepare(key(3)),
    ];
    assert_eq!(next, expected);
}

#[test]
fn a_result_is_kept_until_it_is_settled() {
    let mut agent = ready(1);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Disconnected);
    assert_eq!(tell(&mut agent, Event::Rendered(LeaseId(1))), []);
    assert_eq!(tell(&mut agent, Event::Welcomed { session: SESSION }), [Action::Deliver(LeaseId(1))]);
    tell(&mut agent, Event::Disconnected);
    assert_eq!(tell(&mut agent, Event::Welcomed { session: SESSION }), [Action::Deliver(LeaseId(1))]);
    assert_eq!(tell(&mut agent, Event::Settled(LeaseId(1))), [Action::Discard(LeaseId(1))]);
    assert_eq!(tell(&mut agent, Event::Settled(LeaseId(1))), []);
}

#[test]
fn another_coordinator_gets_nothing_of_the_former_one() {
    let mut agent = ready(2);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 0)));
    tell(&mut agent, Event::Disconnected);
    tell(&mut agent, Event::Rendered(LeaseId(1)));
    let actions = tell(&mut agent, Event::Welcomed { session: 2 });
    assert_eq!(actions, [Action::Discard(LeaseId(1)), Action::Stop(LeaseId(2)), Action::Forget(key(0))]);
    tell(&mut agent, Event::Stopped(LeaseId(2)));
    assert_eq!(tell(&mut agent, Event::Granted(grant(1, 0))), [Action::Prepare(key(0))]);
}

#[test]
fn revoked_units_are_dropped_or_stopped() {
    let mut agent = ready(1);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 0)));
    assert_eq!(tell(&mut agent, Event::Revoked(LeaseId(2))), []);
    assert_eq!(tell(&mut agent, Event::Revoked(LeaseId(1))), [Action::Stop(LeaseId(1))]);
    assert_eq!(tell(&mut agent, Event::Stopped(LeaseId(1))), []);
    assert!(agent.leases().is_empty());
}

#[test]
fn draining_finishes_what_runs_and_returns_the_rest() {
    let mut agent = ready(1);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 0)));
    let actions = tell(&mut agent, Event::Drain);
    assert_eq!(actions, [Action::Return(LeaseId(2)), Action::AnnounceDraining]);
    assert_eq!(tell(&mut agent, Event::Granted(grant(3, 0))), [Action::Return(LeaseId(3))]);
    assert_eq!(tell(&mut agent, Event::Rendered(LeaseId(1))), [Action::Deliver(LeaseId(1))]);
    assert_eq!(tell(&mut agent, Event::Settled(LeaseId(1))), [Action::Discard(LeaseId(1)), Action::Leave]);
}

#[test]
fn draining_without_a_coordinator_leaves_at_once() {
    let mut agent = Agent::new(1);
    assert_eq!(tell(&mut agent, Event::Drain), [Action::Leave]);
}

#[test]
fn a_frame_that_cannot_be_prepared_fails_its_units_only() {
    let mut agent = ready(1);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 0)));
    tell(&mut agent, Event::Granted(grant(3, 7)));
    let actions = tell(&mut agent, Event::PrepareFailed(key(7), "no camera 9".to_owned()));
    assert_eq!(actions, [Action::Report(LeaseId(3), "no camera 9".to_owned())]);
    assert_eq!(agent.leases(), [LeaseId(2), LeaseId(1)]);
}

#[test]
fn a_unit_that_fails_frees_its_slot() {
    let mut agent = ready(1);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 0)));
    let actions = tell(&mut agent, Event::Failed(LeaseId(1), "panicked".to_owned()));
    assert_eq!(actions, [Action::Report(LeaseId(1), "panicked".to_owned()), Action::Start(grant(2, 0))]);
}

#[test]
fn a_frame_that_does_not_fit_is_refused_and_its_job_with_it() {
    let mut agent = Agent::new(1);
    tell(&mut agent, Event::Welcomed { session: SESSION });
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 1)));
    let refusal = Action::Refuse(JobId(1), "9 GB of 4".to_owned());
    let refused = tell(&mut agent, Event::TooLarge(key(0), "9 GB of 4".to_owned()));
    assert_eq!(refused, std::slice::from_ref(&refusal));
    assert!(agent.leases().is_empty());
    assert_eq!(tell(&mut agent, Event::Granted(grant(3, 0))), [refusal]);
    tell(&mut agent, Event::Welcomed { session: SESSION + 1 });
    assert_eq!(
        tell(&mut agent, Event::Granted(grant(4, 0))),
        [Action::Prepare(key(0))],
        "another job by now"
    );
}

#[test]
fn where_memory_is_short_one_frame_follows_the_other() {
    let mut agent = ready(1);
    tell(&mut agent, Event::MemoryShort);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    assert_eq!(tell(&mut agent, Event::Granted(grant(2, 1))), [], "the first one is needed");
    let next = tell(&mut agent, Event::Rendered(LeaseId(1)));
    assert_eq!(next, [Action::Deliver(LeaseId(1)), Action::Forget(key(0)), Action::Prepare(key(1))]);
}

#[test]
fn when_time_is_up_what_is_running_goes_back_as_far_as_it_is() {
    let mut agent = ready(2);
    tell(&mut agent, Event::Granted(grant(1, 0)));
    tell(&mut agent, Event::Granted(grant(2, 0)));
    assert_eq!(tell(&mut agent, Event::Drain), [Action::AnnounceDraining]);
    let back = tell(&mut agent, Event::TimeIsUp);
    assert_eq!(back, [Action::HandBack(LeaseId(1)), Action::HandBack(LeaseId(2))]);
    // Something of the first one is finished, nothing of the second.
    assert_eq!(tell(&mut agent, Event::Rendered(LeaseId(1))), [Action::Deliver(LeaseId(1))]);
    assert_eq!(tell(&mut agent, Event::Stopped(LeaseId(2))), [Action::Return(LeaseId(2))]);
    let left = tell(&mut agent, Event::Settled(LeaseId(1)));
    assert_eq!(left, [Action::Discard(LeaseId(1)), Action::Leave]);
}
