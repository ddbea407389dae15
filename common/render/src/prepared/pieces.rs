//! Where the shutter has to be cut: at the STEP keys within it, at which things are elsewhere from one moment to the next.

use super::track::STEPS;
use farm_scene::{Channel, Interpolation, Path, Scene};

/// Most jumps that a shutter is cut at. What has more is a flicker: it is met at as many times as everything else that moves, and
/// blends from one to the next.
const JUMPS_MAX: usize = 64;

/// A part of the shutter within which nothing jumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Piece {
    /// Beginning and end as fractions of the shutter's time.
    pub from: f32,
    pub to: f32,
    /// First and last moment at which to ask for poses, seconds; the last is before the jump.
    begin: f64,
    end: f64,
}

impl Piece {
    /// The time of a step of [`STEPS`], seconds.
    pub fn seconds(&self, step: u32) -> f64 {
        if step == STEPS {
            return self.end;
        }
        self.begin + (self.end - self.begin) * (f64::from(step) / f64::from(STEPS))
    }
}

/// The pieces of a shutter that is open between two times, seconds.
pub(super) fn pieces(scene: &Scene, open: f64, close: f64) -> Vec<Piece> {
    let mut pieces = vec![Piece { from: 0.0, to: 1.0, begin: open, end: close }];
    let mut jumps: Vec<f64> =
        scene.channels.iter().flat_map(jumps).filter(|&t| open < t && t <= close).collect();
    jumps.sort_unstable_by(f64::total_cmp);
    jumps.dedup();
    if jumps.len() > JUMPS_MAX {
        return pieces;
    }
    for jump in jumps {
        let fraction = ((jump - open) / (close - open)) as f32;
        let last = pieces.last_mut().expect("there is a first piece");
        if fraction <= last.from {
            // Too near to the beginning to be told from it: how things are after the jump is how they begin.
            last.begin = jump;
        } else if fraction >= 1.0 {
            // No ray is that late.
            last.end = last.end.min(jump.next_down());
        } else {
            (last.to, last.end) = (fraction, jump.next_down());
            pieces.push(Piece { from: fraction, to: 1.0, begin: jump, end: close });
        }
    }
    pieces
}

/// The times at which a channel jumps.
fn jumps(channel: &Channel) -> impl Iterator<Item = f64> + '_ {
    let steps = channel.interpolation == Interpolation::Step;
    let changes = |key: usize| match &channel.path {
        Path::Translation(values) | Path::Scale(values) => values[key - 1] != values[key],
        Path::Rotation(values) => values[key - 1] != values[key],
        Path::MorphWeights { targets, values } => {
            let targets = *targets as usize;
            values[(key - 1) * targets..key * targets] != values[key * targets..(key + 1) * targets]
        }
    };
    let keys = if steps { 1..channel.times.len() } else { 0..0 };
    keys.filter(move |&key| changes(key)).map(|key| f64::from(channel.times[key]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn jumping(times: &[f32]) -> Scene {
        let path = Path::Translation((0..times.len()).map(|i| Vec3::X * i as f32).collect());
        let channel = Channel { node: 0, times: times.to_vec(), interpolation: Interpolation::Step, path };
        Scene { channels: vec![channel], ..Scene::default() }
    }

    fn cuts(times: &[f32], open: f64, close: f64) -> Vec<f32> {
        pieces(&jumping(times), open, close)[1..].iter().map(|piece| piece.from).collect()
    }

    #[test]
    fn a_shutter_is_cut_where_a_key_within_it_changes_something() {
        assert_eq!(cuts(&[0.0, 1.0, 2.0, 3.0], 1.5, 3.5), [0.25, 0.75]);
        assert_eq!(cuts(&[0.0, 1.0, 2.0], 1.0, 1.5), [0.0; 0]);
        let mut still = jumping(&[0.0, 1.0]);
        still.channels[0].path = Path::Translation(vec![Vec3::X; 2]);
        assert_eq!(pieces(&still, 0.0, 2.0).len(), 1);
    }

    #[test]
    fn jumps_at_the_ends_of_the_shutter_do_not_reach_into_it() {
        let at_end = pieces(&jumping(&[0.0, 2.0]), 0.0, 2.0);
        assert!(at_end.len() == 1 && at_end[0].seconds(STEPS) < 2.0);
        let just_open = pieces(&jumping(&[0.0, f32::from_bits(1)]), 0.0, 2.0);
        assert_eq!(just_open[0].seconds(0), f64::from(f32::from_bits(1)));
    }

    #[test]
    fn a_flicker_is_not_cut_into_pieces_without_number() {
        let times: Vec<f32> = (0..100_000).map(|i| i as f32).collect();
        assert_eq!(cuts(&times, 0.5, 99_000.0), [0.0; 0]);
        assert_eq!(cuts(&times, 0.5, 64.5).len(), 64);
    }
}
