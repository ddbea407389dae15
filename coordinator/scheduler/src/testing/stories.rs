//! What happens to a lease, a worker, a job, told one at a time.

use super::farm::{A, B, C, Farm, Held, JOB, OTHER_JOB, block, delivery};
use super::spec;
use crate::{Action, Event, JobFault, LEASE_TTL, Verdict, WhyDisconnect, WhyIdle};
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{JobSpec, JobState};
use std::time::Duration;

const SECOND: Duration = Duration::from_secs(1);

fn one_tile_job() -> JobSpec {
    spec(8, 8, 8, 16, "0")
}

fn tiles_job(tiles: u32, spp: u64) -> JobSpec {
    spec(8 * tiles, 8, 8, spp, "0")
}

/// A job and a worker that was seen to render `samples` pixel samples per second.
fn measured(mut farm: Farm, samples: u64) -> Farm {
    let held = farm.first_of(A);
    let rendered = held.unit.tile.area() as u64 * held.unit.block.samples();
    farm.finish(held, SECOND * rendered as u32 / samples as u32);
    farm
}

#[test]
fn unit_of_a_silent_worker_goes_to_another() {
    let mut farm = Farm::with_workers(2).submit(one_tile_job());
    let held = farm.first_of(A);
    assert_eq!(farm.held_by(B), []);
    farm.silence(A);
    farm.advance(LEASE_TTL);
    assert_eq!(farm.news, [Action::Disconnect { worker: A, why: WhyDisconnect::Silent }]);
    let again = farm.first_of(B);
    assert_eq!((again.unit, again.attempt), (held.unit, 2));
    assert_eq!(farm.job(JOB).expired, 1);
}

#[test]
fn heartbeats_keep_a_lease_for_as_long_as_it_takes() {
    let mut farm = Farm::with_workers(2).submit(one_tile_job());
    let held = farm.first_of(A);
    farm.advance(LEASE_TTL * 100);
    assert_eq!(farm.held, [held]);
    farm.finish(held, SECOND);
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn lease_that_its_worker_never_received_is_granted_again() {
    let mut farm = Farm::with_workers(1).submit(one_tile_job());
    farm.held.clear();
    farm.advance(LEASE_TTL + SECOND);
    assert_eq!(farm.first_of(A).attempt, 2);
}

#[test]
fn late_result_is_taken_while_its_unit_is_open_and_frees_who_renders_it_again() {
    let mut farm = Farm::with_workers(2).submit(one_tile_job());
    let late = farm.first_of(A);
    farm.silence(A);
    farm.advance(LEASE_TTL);
    let again = farm.first_of(B);
    farm.finish(late, SECOND);
    farm.expect_state(JOB, JobState::Done);
    assert_eq!(farm.held_by(B), [], "the second copy is revoked");
    assert_eq!(farm.claim(again), Verdict::NotNeeded);
    assert_eq!(farm.scheduler.status(farm.now).workers.len(), 1);
}

#[test]
fn second_result_is_dropped_and_counted() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(2, 16));
    let held = farm.first_of(A);
    farm.finish(held, SECOND);
    assert_eq!(farm.claim(held), Verdict::NotNeeded);
    assert_eq!(farm.job(JOB).duplicates, 1);
}

#[test]
fn of_two_overlapping_results_one_is_wanted() {
    let mut farm = measured(Farm::with_workers(1).submit(spec(8, 8, 8, 256, "0")), 1_000_000_000);
    while farm.first_of(A).unit.block != block(64..128) {
        farm.finish(farm.first_of(A), Duration::from_nanos(1));
    }
    let whole = farm.first_of(A);
    let half = Held { unit: WorkUnit { block: block(64..96), ..whole.unit }, ..whole };
    assert_eq!(farm.claim(half), Verdict::Wanted);
    assert_eq!(farm.claim(whole), Verdict::NotNeeded, "a part of it is on its way to the store");
    farm.tell(Event::StoreFailed { delivery: delivery(half) });
    assert_eq!(farm.scheduler.wants(JOB, &whole.unit), Verdict::Wanted);
    assert_eq!(farm.claim(whole), Verdict::Wanted);
}

#[test]
fn what_is_no_unit_of_the_job_is_foreign() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(2, 32));
    let held = farm.first_of(A);
    let tile = Tile::new(0, 0, 16, 8).unwrap();
    assert_eq!(farm.claim(Held { unit: WorkUnit { tile, ..held.unit }, ..held }), Verdict::Foreign);
    let again = farm.finish_all();
    assert!(again.iter().any(|other| other.unit == held.unit), "the unit it was for is rendered again");
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn every_tile_gets_a_round_before_any_tile_gets_the_next() {
    let mut farm = Farm::with_workers(2).submit(spec(16, 16, 8, 64, "1-2"));
    let round = |unit: WorkUnit| (unit.frame, unit.block.end().next_power_of_two());
    let order: Vec<_> = farm.finish_all().iter().map(|held| round(held.unit)).collect();
    assert!(order.is_sorted(), "{order:?}");
    let rounds: Vec<_> = farm
        .news
        .iter()
        .filter_map(|action| match action {
            Action::RoundComplete { frame, spp, .. } => Some((frame.0, *spp)),
            _ => None,
        })
        .collect();
    assert_eq!(rounds, [(1, 16), (1, 32), (1, 64), (2, 16), (2, 32), (2, 64)]);
    assert_eq!(farm.news.last(), Some(&Action::JobDone { job: JOB }));
}

#[test]
fn next_frame_begins_while_the_last_tile_of_this_one_is_out() {
    let mut farm = Farm::with_workers(2).submit(spec(8, 8, 8, 16, "1-3"));
    let slow = farm.first_of(A);
    farm.finish(farm.first_of(B), SECOND);
    let frames: Vec<_> = farm.held.iter().map(|held| held.unit.frame.0).collect();
    assert_eq!(frames, [1, 3]);
    assert_eq!(farm.news.last(), Some(&Action::FrameComplete { job: JOB, frame: FrameIndex(2), spp: 16 }));
    farm.finish(slow, SECOND);
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn fast_worker_gets_large_blocks_and_a_slow_one_small_ones_of_the_same_round() {
    let mut farm = Farm::with_workers(0).submit(spec(8, 8, 8, 4096, "0-99"));
    farm.join(A, 1);
    // A renders a sample per pixel in a millisecond: 1024 of them fit into the target.
    while farm.first_of(A).unit.block.start() < 2048 {
        let held = farm.first_of(A);
        farm.finish(held, Duration::from_millis(held.unit.block.samples()));
    }
    assert_eq!(farm.first_of(A).unit.block, block(2048..3072));
    farm.join(B, 1);
    for _ in 0..20 {
        let held = farm.first_of(B);
        farm.finish(held, Duration::from_millis(16 * held.unit.block.samples()));
    }
    assert_eq!(farm.first_of(B).unit.block.samples(), 64);
}

#[test]
fn part_of_a_unit_leaves_the_rest_open() {
    let mut farm = measured(Farm::with_workers(1).submit(spec(8, 8, 8, 256, "0")), 1_000_000_000);
    while farm.first_of(A).unit.block != block(128..256) {
        farm.finish(farm.first_of(A), Duration::from_nanos(1));
    }
    let whole = farm.first_of(A);
    farm.tell(Event::WorkerDraining { worker: A });
    farm.finish(Held { unit: WorkUnit { block: block(160..192), ..whole.unit }, ..whole }, SECOND);
    assert_eq!(farm.news.last(), Some(&Action::Disconnect { worker: A, why: WhyDisconnect::Drained }));
    assert_eq!(farm.scheduler.status(farm.now).workers, []);
    farm.join(B, 4);
    let rest: Vec<_> = farm.held_by(B).iter().map(|held| held.unit.block.start()).collect();
    assert_eq!(rest.first(), Some(&128));
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn failed_unit_goes_to_another_worker() {
    let mut farm = Farm::with_workers(2).submit(one_tile_job());
    let failed = farm.first_of(A);
    farm.fail(failed);
    assert_eq!(farm.held_by(A), []);
    assert_eq!(farm.first_of(B).unit, failed.unit);
}

#[test]
fn unit_that_fails_on_three_workers_fails_its_job_and_no_other() {
    let mut farm = Farm::with_workers(3).submit(one_tile_job());
    for worker in [A, B, C] {
        farm.expect_state(JOB, JobState::Running);
        farm.fail(farm.first_of(worker));
    }
    let Some(Action::JobFailed { job: JOB, fault }) = farm.news.last() else { panic!("{:?}", farm.news) };
    assert_eq!(
        fault.to_string(),
        "frame 0 tile [0,8)x[0,8) samples 0..16 failed 3 times, on A, B, C: pdf is not finite"
    );
    let mut farm = farm.submit(tiles_job(4, 16));
    farm.finish_all();
    farm.expect_state(OTHER_JOB, JobState::Done);
    farm.tell(Event::JobRequeued { job: JOB });
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn only_worker_tries_three_times() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(2, 16));
    for attempt in 1..=3 {
        let held = farm.first_of(A);
        let first = *farm.held.iter().min_by_key(|held| held.unit).unwrap();
        assert_eq!(first.attempt, attempt, "{held:?}");
        farm.fail(first);
    }
    farm.expect_state(JOB, JobState::Failed);
    assert_eq!(farm.held, [], "what it holds of the job is revoked");
}

#[test]
fn scene_that_kills_every_worker_ends() {
    let mut farm = Farm::with_workers(0).submit(one_tile_job());
    for _ in 0..12 {
        farm.expect_state(JOB, JobState::Running);
        farm.join(A, 1);
        farm.tell(Event::WorkerLeft { worker: A });
    }
    let fault = farm.news.iter().find_map(|action| match action {
        Action::JobFailed { fault, .. } => Some(fault),
        _ => None,
    });
    assert!(matches!(fault, Some(JobFault::UnitLost { times: 12, .. })), "{fault:?}");
}

#[test]
fn worker_that_keeps_failing_waits_in_quarantine_and_longer_the_next_time() {
    let mut farm = Farm::with_workers(2).submit(tiles_job(64, 16));
    let quarantined = |farm: &Farm| farm.scheduler.status(farm.now).workers[0].quarantined_for;
    for _ in 0..3 {
        assert_eq!(quarantined(&farm), None);
        farm.reject(farm.first_of(A));
    }
    assert_eq!(quarantined(&farm), Some(SECOND * 10));
    assert_eq!(farm.held_by(A), [], "what it holds goes elsewhere");
    farm.tell(Event::WorkerLeft { worker: A });
    farm.join(A, 1);
    assert_eq!(farm.held_by(A), [], "coming back changes nothing");
    farm.advance(SECOND * 10);
    assert_eq!(quarantined(&farm), None);
    farm.reject(farm.first_of(A));
    assert_eq!(quarantined(&farm), Some(SECOND * 20), "on probation, one failure suffices");
    farm.advance(SECOND * 20);
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn workers_that_failed_a_job_at_fault_are_forgiven() {
    let mut farm = Farm::with_workers(3).submit(tiles_job(64, 16));
    while farm.job(JOB).state == JobState::Running {
        let held = farm.held[0];
        farm.fail(held);
    }
    let mut farm = farm.submit(tiles_job(6, 16));
    assert!([A, B, C].iter().all(|worker| !farm.held_by(*worker).is_empty()), "{:?}", farm.held);
    farm.finish_all();
    farm.expect_state(OTHER_JOB, JobState::Done);
}

#[test]
fn paused_job_gets_nothing_but_keeps_what_comes() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(8, 16));
    farm.tell(Event::JobPaused { job: JOB });
    let held = farm.held.clone();
    farm.finish_all();
    assert_eq!(farm.job(JOB).units_done, held.len() as u64);
    assert_eq!(farm.scheduler.status(farm.now).why_idle, Some(WhyIdle::Paused));
    farm.tell(Event::JobResumed { job: JOB });
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn cancelled_job_is_revoked_and_its_results_are_dropped() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(8, 16));
    let held = farm.first_of(A);
    farm.tell(Event::JobCancelled { job: JOB });
    assert_eq!(farm.held, []);
    assert_eq!(farm.claim(held), Verdict::NotNeeded);
    farm.expect_state(JOB, JobState::Cancelled);
    assert_eq!(farm.scheduler.status(farm.now).why_idle, Some(WhyIdle::NoJobs));
}

#[test]
fn higher_priority_goes_first_and_equals_share() {
    let urgent = JobSpec { priority: 1, ..tiles_job(4, 16) };
    let mut farm = Farm::with_workers(0).submit(tiles_job(40, 16)).submit(tiles_job(40, 16)).submit(urgent);
    farm.join(A, 1);
    let order: Vec<u64> = farm.finish_all().iter().map(|held| held.job.0).collect();
    assert_eq!(order[..4], [2, 2, 2, 2]);
    let first = order[4..44].iter().filter(|job| **job == 0).count();
    assert!((15..=25).contains(&first), "{first} of 40 units went to the first of two equal jobs: {order:?}");
}

#[test]
fn newcomer_does_not_starve_who_was_there() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(100, 16));
    for _ in 0..50 {
        farm.finish(farm.first_of(A), SECOND);
    }
    let mut farm = farm.submit(tiles_job(100, 16));
    let order: Vec<u64> = farm.finish_all().iter().take(20).map(|held| held.job.0).collect();
    assert!(order.iter().filter(|job| **job == 0).count() >= 8, "{order:?}");
}

#[test]
fn time_that_a_job_was_paused_is_no_credit() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(100, 16)).submit(tiles_job(100, 16));
    farm.tell(Event::JobPaused { job: OTHER_JOB });
    for _ in 0..50 {
        farm.finish(farm.first_of(A), SECOND);
    }
    farm.tell(Event::JobResumed { job: OTHER_JOB });
    let order: Vec<u64> = farm.finish_all().iter().take(20).map(|held| held.job.0).collect();
    assert!(order.iter().filter(|job| **job == 0).count() >= 8, "{order:?}");
}

#[test]
fn idle_worker_copies_a_slow_unit_and_the_first_result_counts() {
    let mut farm = Farm::speculating(2).submit(tiles_job(2, 16));
    let slow = farm.first_of(A);
    farm.finish(farm.first_of(B), Duration::from_millis(100));
    farm.advance(Duration::from_millis(100));
    assert_eq!(farm.held, [slow], "it is not late yet");
    farm.advance(SECOND * 3);
    let copies: Vec<_> = farm.held.iter().map(|held| (held.unit, held.worker)).collect();
    assert_eq!(copies, [(slow.unit, A), (slow.unit, B)], "one copy, on the other worker");
    farm.finish(farm.first_of(B), SECOND);
    assert_eq!(farm.held, [], "the slow one is revoked");
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn idle_worker_takes_over_what_only_waits_at_a_busy_one() {
    let mut farm = Farm::speculating(1).submit(tiles_job(3, 16));
    farm.finish(farm.first_of(A), SECOND);
    assert_eq!(farm.held_by(A).len(), 2);
    farm.join(B, 1);
    assert_eq!(farm.first_of(B).unit, farm.held_by(A)[1].unit);
}

#[test]
fn each_slot_has_a_unit_and_one_that_waits() {
    let mut farm = Farm::with_workers(0).submit(tiles_job(64, 16));
    farm.join(A, 4);
    assert_eq!(farm.held.len(), 8);
    farm.finish(farm.first_of(A), Duration::from_millis(10));
    farm.tell(Event::Heartbeat {
        worker: A,
        leases: Vec::new(),
        round_trip: Some(Duration::from_millis(80)),
    });
    assert_eq!(farm.held.len(), 4 + 40, "ten short units per slot end while a message goes there and back");
}

#[test]
fn few_units_are_spread_before_any_worker_gets_a_second() {
    let mut farm = Farm::with_workers(0);
    for worker in [A, B, C] {
        farm.join(worker, 1);
    }
    let farm = farm.submit(tiles_job(3, 16));
    assert_eq!([A, B, C].map(|worker| farm.held_by(worker).len()), [1, 1, 1]);
}

#[test]
fn frame_that_is_good_enough_ends_early() {
    let mut farm = Farm::with_workers(1).submit(spec(16, 8, 8, 256, "0-1"));
    while !matches!(farm.news.last(), Some(Action::RoundComplete { spp: 32, .. })) {
        farm.finish(farm.first_of(A), SECOND);
    }
    let current = farm.job(JOB).current.unwrap();
    assert_eq!((current.spp_complete, current.spp_begun), (32, 64));
    let beyond = farm.first_of(A);
    farm.tell(Event::FrameTruncated { job: JOB, frame: FrameIndex(0), spp: 40 });
    assert_eq!(farm.first_of(A), beyond, "40 is not the end of a round");
    farm.tell(Event::FrameTruncated { job: JOB, frame: FrameIndex(0), spp: 32 });
    assert_eq!(farm.news.last(), Some(&Action::FrameComplete { job: JOB, frame: FrameIndex(0), spp: 32 }));
    assert_eq!(farm.claim(beyond), Verdict::NotNeeded);
    assert_eq!(farm.first_of(A).unit.frame, FrameIndex(1));
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
    let status = farm.job(JOB);
    assert_eq!((status.samples_done, status.samples), (128 * (32 + 256), 128 * (32 + 256)));
}

#[test]
fn a_tile_that_has_ended_gets_nothing_more_and_its_frame_goes_on() {
    let mut farm = Farm::with_workers(1).submit(spec(16, 8, 8, 64, "0-1"));
    let round = |spp| Action::RoundComplete { job: JOB, frame: FrameIndex(0), spp };
    while farm.news.last() != Some(&round(16)) {
        farm.finish(farm.first_of(A), SECOND);
    }
    let beyond = farm.first_of(A);
    assert_eq!(beyond.unit.block.start(), 16);
    let end = |spp| Event::TilesEnded { job: JOB, frame: FrameIndex(0), tiles: vec![beyond.unit.tile], spp };
    farm.tell(end(20));
    assert!(farm.held.contains(&beyond), "20 is not the end of a round");
    farm.tell(end(16));
    let is_of_it = |held: &Held| (held.unit.frame, held.unit.tile) == (FrameIndex(0), beyond.unit.tile);
    assert!(!farm.held.iter().any(is_of_it));
    assert_eq!(farm.claim(beyond), Verdict::NotNeeded);
    assert!(!farm.finish_all().iter().any(is_of_it));
    farm.expect_state(JOB, JobState::Done);
    assert!(farm.news.contains(&round(32)), "what is left of the frame goes through its rounds");
    let samples = 64 * (64 + 16 + 2 * 64);
    assert_eq!((farm.job(JOB).samples_done, farm.job(JOB).samples), (samples, samples));
}

#[test]
fn a_frame_ends_when_its_last_tile_does() {
    let mut farm = Farm::with_workers(1).submit(spec(16, 8, 8, 64, "0"));
    for (x0, spp) in [(0, 16), (8, 32)] {
        while farm.news.last() != Some(&Action::RoundComplete { job: JOB, frame: FrameIndex(0), spp }) {
            farm.finish(farm.first_of(A), SECOND);
        }
        let tiles = vec![Tile::new(x0, 0, x0 + 8, 8).unwrap()];
        farm.tell(Event::TilesEnded { job: JOB, frame: FrameIndex(0), tiles, spp });
    }
    assert!(farm.news.contains(&Action::FrameComplete { job: JOB, frame: FrameIndex(0), spp: 32 }));
    farm.expect_state(JOB, JobState::Done);
    assert_eq!(farm.job(JOB).samples, 64 * (16 + 32));
}

#[test]
fn restarted_job_renders_only_what_is_missing() {
    let spec = spec(16, 8, 8, 64, "0-2");
    let tile = |x0| Tile::new(x0, 0, x0 + 8, 8).unwrap();
    let unit = |frame, x0, range| WorkUnit { frame: FrameIndex(frame), block: block(range), tile: tile(x0) };
    // Frame 0 is all there, merged; of frame 1 the left tile lacks [16,32) and the right one half of [32,64).
    let durable = vec![
        unit(1, 0, 32..64),
        unit(0, 8, 0..64),
        unit(1, 8, 32..48),
        unit(1, 0, 0..16),
        unit(0, 0, 0..64),
        unit(1, 8, 0..32),
        unit(7, 0, 0..64),
        unit(1, 0, 0..16),
    ];
    let mut farm = Farm::with_workers(1).restarted_with(spec, durable);
    assert!(farm.news.contains(&Action::FrameComplete { job: JOB, frame: FrameIndex(0), spp: 64 }));
    assert_eq!(farm.job(JOB).samples_done, 128 * 64 + 64 * (16 + 32) + 64 * (32 + 16));
    let rendered: Vec<_> = farm.finish_all().iter().map(|held| held.unit).collect();
    assert_eq!(rendered[..2], [unit(1, 0, 16..32), unit(1, 8, 48..64)]);
    assert!(rendered[2..].iter().all(|unit| unit.frame == FrameIndex(2)), "{rendered:?}");
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn coordinator_that_stood_still_does_not_take_its_own_silence_for_the_workers() {
    let mut farm = Farm::with_workers(1).submit(one_tile_job());
    let held = farm.first_of(A);
    farm.now = farm.now.after(SECOND * 60);
    farm.tell(Event::Tick);
    farm.heartbeats();
    farm.advance(SECOND * 10);
    assert_eq!((&farm.held[..], &farm.news[..]), (&[held][..], &[][..]));
    farm.silence(A);
    farm.advance(SECOND * 5);
    assert_eq!(farm.held, [held], "the worker is gone, and nobody else is there");
    assert_eq!(farm.news, [Action::Disconnect { worker: A, why: WhyDisconnect::Silent }]);
}

#[test]
fn refused_job_goes_to_who_can_render_it() {
    let mut farm = Farm::with_workers(2).submit(one_tile_job());
    let held = farm.first_of(A);
    let refuse = |worker| Event::JobRefused { worker, job: JOB, reason: "scene needs 9 GB of 4".to_owned() };
    farm.tell(refuse(A));
    assert_eq!(farm.first_of(B).unit, held.unit);
    assert_eq!(farm.job(JOB).failures, 0);
    farm.tell(refuse(B));
    assert_eq!(
        farm.job(JOB).why_idle.map(|why| why.to_string()),
        Some("every connected worker refuses the job: scene needs 9 GB of 4".to_owned())
    );
}

#[test]
fn slow_store_holds_its_workers_back() {
    let mut farm = Farm::with_workers(1).submit(tiles_job(200, 16));
    let mut claimed = Vec::new();
    while let Some(&held) = farm.held.first() {
        assert_eq!(farm.claim(held), Verdict::Wanted);
        claimed.push(held);
    }
    assert!(claimed.len() < 20, "{} results wait for the store", claimed.len());
    for held in claimed {
        farm.tell(Event::UnitAccepted { delivery: delivery(held), render: SECOND });
    }
    farm.finish_all();
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn absurd_numbers_from_a_worker_do_no_harm() {
    let mut farm = Farm::with_workers(0).submit(spec(65_536, 65_536, 65_536, 1 << 61, "0-4294967295"));
    farm.join(A, u32::MAX);
    farm.tell(Event::Heartbeat { worker: A, leases: Vec::new(), round_trip: Some(Duration::MAX) });
    for render in [Duration::ZERO, Duration::MAX, Duration::ZERO] {
        farm.finish(farm.first_of(A), render);
    }
    assert_eq!(farm.job(JOB).units_done, 3);
    let speed = farm.scheduler.status(farm.now).workers[0].samples_per_s;
    assert!(speed.is_finite() && speed > 0.0, "{speed}");
}

#[test]
fn farm_says_why_nothing_is_rendered() {
    let why = |farm: &Farm| farm.scheduler.status(farm.now).why_idle;
    let farm = Farm::with_workers(0);
    assert_eq!(why(&farm), Some(WhyIdle::NoJobs));
    let mut farm = farm.submit(tiles_job(2, 16));
    assert_eq!(why(&farm), Some(WhyIdle::NoWorkers));
    farm.join(A, 1);
    assert_eq!(why(&farm), None);
    for _ in 0..3 {
        farm.reject(farm.first_of(A));
    }
    assert_eq!(why(&farm), Some(WhyIdle::Quarantined { soonest: SECOND * 10 }));
    farm.advance(SECOND * 10);
    let held = farm.held.clone();
    for held in held {
        assert_eq!(farm.claim(held), Verdict::Wanted);
    }
    assert_eq!(why(&farm), Some(WhyIdle::Storing));
}
