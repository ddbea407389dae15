//! What happens to those whose results differ from the others', told one at a time.

use super::farm::{A, B, C, Farm, Held, JOB, delivery};
use super::{spec, wrong};
use crate::{Action, Config, Event, Origin, Reputation, Verdict, WhyIdle};
use farm_film::{FrameIndex, Tile, WorkUnit};
use farm_job::{Digest, JobSpec, JobState, Stop};
use std::collections::BTreeSet;
use std::time::Duration;

fn tiles_job(tiles: u32, frames: &str) -> JobSpec {
    spec(8 * tiles, 8, 8, 16, frames)
}

/// Everybody renders what is held until nobody holds anything; those in `liars` each in a wrong way of their own.
fn finish_all_but(farm: &mut Farm, liars: &[farm_job::WorkerId]) -> Vec<Held> {
    let mut finished = Vec::new();
    while let Some(&held) = farm.held.first() {
        let digest = match liars.contains(&held.worker) {
            true => wrong(&held.unit, held.worker.0 as u8),
            false => super::honest(&held.unit),
        };
        farm.finish_as(held, digest);
        finished.push(held);
    }
    finished
}

fn reopened(farm: &Farm) -> Vec<(FrameIndex, usize, bool)> {
    let reopened = |action: &Action| match action {
        Action::Reopened { frame, tiles, finished, .. } => Some((*frame, tiles.len(), *finished)),
        _ => None,
    };
    farm.news.iter().filter_map(reopened).collect()
}

fn distrusted(farm: &Farm) -> Vec<u64> {
    let status = farm.scheduler.status(farm.now);
    status.workers.iter().filter(|worker| worker.distrusted).map(|worker| worker.worker.0).collect()
}

#[test]
fn frame_is_complete_when_another_worker_has_rendered_the_same_bits() {
    let mut farm = Farm::verifying(2).submit(tiles_job(1, "0"));
    let first = farm.first_of(A);
    farm.finish(first, Duration::from_secs(1));
    assert!(!farm.news.iter().any(|action| matches!(action, Action::FrameComplete { .. })), "it waits");
    let second = farm.first_of(B);
    assert_eq!(second.unit, first.unit);
    assert_eq!(farm.claim(second), Verdict::Compared);
    farm.expect_state(JOB, JobState::Done);
    assert_eq!((farm.job(JOB).verified, farm.job(JOB).units_done), (1, 1));
}

#[test]
fn third_worker_tells_who_lies_and_all_that_came_from_there_is_rendered_again() {
    let mut farm = Farm::verifying(3).submit(tiles_job(6, "0"));
    finish_all_but(&mut farm, &[B]);
    assert_eq!(distrusted(&farm), [B.0]);
    assert_eq!(farm.held_by(B), [], "it gets nothing any more");
    assert!(reopened(&farm).iter().all(|(_, _, finished)| !finished));
    let status = farm.job(JOB);
    assert_eq!(status.state, JobState::Done);
    assert_eq!(status.samples_done, status.samples);
    assert!(status.units_done > 6, "what the liar delivered was delivered again");
    let reason = farm.news.iter().find_map(|action| match action {
        Action::Distrust { name, reason } => Some((name.as_str(), reason.as_str())),
        _ => None,
    });
    let (name, reason) = reason.unwrap();
    assert!(name == "B" && reason.contains("otherwise than two others"), "{name}: {reason}");
    assert_eq!(farm.scheduler.reputation().distrusted, BTreeSet::from(["B".to_owned()]));
    farm.tell(Event::WorkerForgiven { name: "B".to_owned() });
    assert_eq!(distrusted(&farm), []);
}

fn unit(frame: u32, x: u32) -> WorkUnit {
    let tile = Tile::new(x, 0, x + 8, 8).unwrap();
    WorkUnit { frame: FrameIndex(frame), tile, block: super::farm::block(0..16) }
}

fn delivered(unit: WorkUnit, name: &str, digest: Digest) -> Origin {
    Origin { frame: unit.frame, name: name.to_owned(), part: Some((unit, digest)) }
}

fn took_part(frame: u32, name: &str) -> Origin {
    Origin { frame: FrameIndex(frame), name: name.to_owned(), part: None }
}

#[test]
fn what_a_liar_delivered_before_a_restart_is_rendered_again() {
    // Frame 0 was finished; of frame 1 two tiles of three were there, of which the liar's was right.
    let (of_b, of_a) = (unit(1, 0), unit(1, 8));
    let origins = vec![
        took_part(0, "A"),
        took_part(0, "B"),
        delivered(of_b, "B", super::honest(&of_b)),
        delivered(of_a, "A", super::honest(&of_a)),
        delivered(unit(7, 0), "B", super::honest(&of_b)),
    ];
    let farm = Farm::verifying(0);
    let mut farm = farm.recalling(tiles_job(3, "0-1"), vec![FrameIndex(0)], vec![of_b, of_a], origins);
    for worker in [A, B, C] {
        farm.join(worker, 1);
    }
    finish_all_but(&mut farm, &[B]);
    let (mut again, expected) = (reopened(&farm), [(FrameIndex(0), 3, true), (FrameIndex(1), 1, false)]);
    again.sort();
    assert!(expected.iter().all(|frame| again.contains(frame)), "{again:?}");
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn a_comparison_that_a_restart_interrupted_is_made_up_for() {
    // All samples were there, and nothing was compared; the liar never comes back.
    let units = [unit(0, 0), unit(0, 8)];
    let origins = vec![
        delivered(units[0], "B", wrong(&units[0], 7)),
        delivered(units[1], "A", super::honest(&units[1])),
    ];
    let mut farm = Farm::verifying(0).recalling(tiles_job(2, "0"), Vec::new(), units.to_vec(), origins);
    assert!(
        !farm.news.iter().any(|action| matches!(action, Action::FrameComplete { .. })),
        "it is not believed"
    );
    for worker in [A, C] {
        farm.join(worker, 1);
    }
    finish_all_but(&mut farm, &[]);
    assert_eq!(reopened(&farm), [(FrameIndex(0), 1, false)]);
    assert!(farm.scheduler.reputation().knows("B"));
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn nobody_comes_back_to_compare() {
    let origins = vec![delivered(unit(0, 0), "B", super::honest(&unit(0, 0)))];
    let mut farm = Farm::verifying(0).recalling(tiles_job(1, "0"), Vec::new(), vec![unit(0, 0)], origins);
    farm.join(B, 1);
    farm.advance(Duration::from_secs(9));
    farm.expect_state(JOB, JobState::Running);
    farm.advance(Duration::from_secs(2));
    farm.expect_state(JOB, JobState::Done);
    assert_eq!((farm.job(JOB).verified, farm.job(JOB).unverified), (0, 1));
}

#[test]
fn a_liar_of_a_former_life_gets_nothing() {
    let mut farm = Farm::with_workers(0).submit(tiles_job(2, "0"));
    let distrusted = BTreeSet::from(["B".to_owned()]);
    farm.tell(Event::ReputationRecalled(Reputation { distrusted, quarantined: Vec::new() }));
    farm.join(B, 1);
    assert_eq!(farm.held, []);
    assert_eq!(farm.job(JOB).why_idle, Some(WhyIdle::Distrusted));
    farm.join(A, 1);
    assert!(!farm.held_by(A).is_empty());
}

#[test]
fn what_a_liar_may_have_decided_about_is_rendered_again() {
    let mut job = spec(24, 8, 8, 64, "0-1");
    job.stop = Stop { error: Some(0.1), adaptive: true, ..Stop::default() };
    let mut farm = Farm::verifying(3).submit(job);
    let first = FrameIndex(0);
    while !farm.news.contains(&Action::RoundComplete { job: JOB, frame: first, spp: 32 }) {
        let held = farm.held[0];
        let digest = if held.worker == A { wrong(&held.unit, 1) } else { super::honest(&held.unit) };
        farm.finish_as(held, digest);
        if farm.news.contains(&Action::RoundComplete { job: JOB, frame: first, spp: 16 }) {
            let tiles = vec![Tile::new(0, 0, 8, 8).unwrap()];
            farm.tell(Event::TilesEnded { job: JOB, frame: first, tiles, spp: 16 });
        }
    }
    finish_all_but(&mut farm, &[A]);
    assert_eq!(distrusted(&farm), [A.0]);
    assert!(reopened(&farm).iter().all(|(_, tiles, _)| *tiles == 3), "{:?}", reopened(&farm));
    farm.expect_state(JOB, JobState::Done);
    let status = farm.job(JOB);
    assert_eq!((status.samples_done, status.leases), (status.samples, 0));
}

#[test]
fn liar_that_only_compares_harms_nobody() {
    let mut farm = Farm::verifying(0).submit(tiles_job(1, "0"));
    for worker in [A, B, C] {
        farm.join(worker, 1);
    }
    farm.finish(farm.first_of(A), Duration::from_secs(1));
    let liar = farm.first_of(B);
    assert_eq!(farm.finish_as(liar, wrong(&liar.unit, 7)), Verdict::Compared);
    farm.finish_as(farm.first_of(C), super::honest(&liar.unit));
    assert_eq!((distrusted(&farm), reopened(&farm)), (vec![B.0], vec![]));
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn two_who_differ_wait_for_a_third() {
    let mut farm = Farm::verifying(2).submit(tiles_job(1, "0"));
    finish_all_but(&mut farm, &[A]);
    let Some(WhyIdle::Disputed { unit }) = farm.job(JOB).why_idle else { panic!("{:?}", farm.job(JOB)) };
    farm.expect_state(JOB, JobState::Running);
    farm.join(C, 1);
    assert_eq!(farm.first_of(C).unit, unit);
    finish_all_but(&mut farm, &[A]);
    assert_eq!(distrusted(&farm), [A.0]);
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn worker_alone_finishes_what_nobody_can_compare() {
    let mut farm = Farm::verifying(1).submit(tiles_job(4, "0-1"));
    finish_all_but(&mut farm, &[]);
    farm.expect_state(JOB, JobState::Done);
    assert_eq!((farm.job(JOB).verified, farm.job(JOB).unverified), (0, 8));
}

#[test]
fn check_of_a_worker_that_vanishes_is_given_to_the_next() {
    let mut farm = Farm::verifying(3).submit(tiles_job(1, "0"));
    let first = farm.first_of(A);
    farm.finish(first, Duration::from_secs(1));
    let holder = farm.held[0].worker;
    farm.held.clear();
    farm.tell(Event::WorkerLeft { worker: holder });
    let next = farm.held[0];
    assert_eq!((next.unit, next.attempt), (first.unit, 2));
    farm.claim(next);
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn finished_frames_and_done_jobs_are_opened_again_when_a_liar_is_found_in_another() {
    // Nothing of the first job is chosen, all of the second one is.
    let job = || spec(8 * 4, 8, 8, 16, "0");
    let verify_seed = (0..).find(|seed| {
        let lots = |job| (0..4).map(move |tile| crate::verify::lot_of_tile(*seed, job, tile * 8));
        lots(0).all(|lot| lot > 0.5) && lots(1).all(|lot| lot < 0.5)
    });
    let verify_seed = verify_seed.expect("some seed chooses so");
    let config = Config { speculate: false, verify: 0.5, verify_seed, ..Config::default() };
    let mut farm = Farm::of(3, config).submit(job());
    finish_all_but(&mut farm, &[B]);
    farm.expect_state(JOB, JobState::Done);
    let mut farm = farm.submit(job());
    finish_all_but(&mut farm, &[B]);
    assert!(reopened(&farm).contains(&(FrameIndex(0), 4, true)), "{:?}", farm.news);
    for job in farm.scheduler.status(farm.now).jobs {
        assert_eq!((job.state, job.samples_done), (JobState::Done, job.samples));
    }
    let complete = |action: &&Action| matches!(action, Action::FrameComplete { job: JOB, .. });
    assert_eq!(farm.news.iter().filter(complete).count(), 2, "the first job's frame, and the same again");
}

#[test]
fn what_a_liar_has_on_its_way_to_the_store_counts_for_nothing() {
    let mut farm = Farm::verifying(0).submit(tiles_job(2, "0"));
    farm.join(A, 2);
    let (late, checked) = (farm.held_by(A)[0], farm.held_by(A)[1]);
    let lie = |held: Held| crate::Delivery { digest: wrong(&held.unit, 1), ..delivery(held) };
    assert_eq!(farm.scheduler.claim(farm.now, &lie(late)), Verdict::Wanted);
    farm.finish_as(checked, wrong(&checked.unit, 1));
    farm.join(B, 1);
    farm.join(C, 1);
    for worker in [B, C] {
        farm.finish_as(farm.first_of(worker), super::honest(&checked.unit));
    }
    assert_eq!(distrusted(&farm), [A.0]);
    farm.tell(Event::UnitAccepted { delivery: lie(late), render: Duration::from_secs(1) });
    assert_eq!(farm.job(JOB).samples_done, 0);
    finish_all_but(&mut farm, &[]);
    farm.expect_state(JOB, JobState::Done);
}

#[test]
fn result_that_is_none_is_tried_elsewhere_first() {
    let mut farm = Farm::with_workers(2).submit(tiles_job(1, "0"));
    let rejected = farm.first_of(A);
    farm.reject(rejected);
    assert_eq!(farm.first_of(B).unit, rejected.unit);
    farm.tell(Event::WorkerLeft { worker: B });
    farm.held.retain(|held| held.worker != B);
    assert_eq!(farm.first_of(A).unit, rejected.unit, "nobody else is left");
}

#[test]
fn about_the_asked_part_of_the_units_is_compared() {
    let config = Config { speculate: false, verify: 0.02, verify_seed: 5, ..Config::default() };
    let mut farm = Farm::of(2, config).submit(spec(800, 800, 8, 16, "0"));
    farm.finish_everything();
    farm.expect_state(JOB, JobState::Done);
    let verified = farm.job(JOB).verified;
    assert!((150..=250).contains(&verified), "{verified} of 10,000");
}
