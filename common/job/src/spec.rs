//! A job as it is submitted.

use crate::rounds;
use farm_film::{FrameIndex, Resolution, SampleBlock, SampleRange};
use farm_scene::{SceneId, Settings};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Frames `first, first + step, ..` up to and including `last`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameRange {
    first: u32,
    last: u32,
    step: u32,
}

/// A job that cannot be done.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JobSpecError {
    /// Reversed, or a step of zero.
    #[error(
        "frames {first}-{last} in steps of {step} hold no frame: the first may not exceed the last, and the step is at least 1"
    )]
    Frames {
        /// First frame.
        first: u32,
        /// Last frame.
        last: u32,
        /// Distance.
        step: u32,
    },
    /// Not `5`, `1-24` or `1-24x2`.
    #[error("{0:?} is no frame range: write a frame (5), a range (1-24) or a range with a step (1-24x2)")]
    FrameSyntax(String),
    /// Resolution out of range.
    #[error(transparent)]
    Resolution(#[from] farm_film::TileError),
    /// No sample asked for.
    #[error(transparent)]
    Samples(#[from] farm_film::SampleBlockError),
    /// No pixel in a tile.
    #[error("a tile of 0 pixels cannot be rendered")]
    Tile,
    /// A frame rate that gives no time.
    #[error("{0} frames per second is no frame rate")]
    FrameRate(f64),
    /// An error that nothing falls below.
    #[error("a frame cannot stop at an error of {0}: a relative mean squared error is above 0")]
    StopError(f64),
    /// No time to render in.
    #[error("a frame cannot stop after no time at all")]
    StopTime,
    /// Tiles that are to stop on their own, and do not know when.
    #[error(
        "tiles can only end on their own on the way to an error, and none is given: --adaptive needs --error"
    )]
    StopTiles,
}

/// When a frame ends before it has all its samples; whichever comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stop {
    /// Once its estimated relative mean squared error is at most this, > 0.
    pub error: Option<f64>,
    /// Once this much time has passed since its first unit was begun.
    pub time: Option<Duration>,
    /// Not for its error before it has so many samples per pixel.
    pub spp_min: u64,
    /// Tiles also end on their own, at powers of two, once more of their samples would take less off the frame's error than those of
    /// others.
    pub adaptive: bool,
}

impl Stop {
    /// Whether all frames get all samples.
    pub fn is_never(&self) -> bool {
        self.error.is_none() && self.time.is_none()
    }

    fn validate(&self) -> Result<(), JobSpecError> {
        match *self {
            Self { error: Some(error), .. } if !(error.is_finite() && error > 0.0) => {
                Err(JobSpecError::StopError(error))
            }
            Self { time: Some(Duration::ZERO), .. } => Err(JobSpecError::StopTime),
            Self { error: None, adaptive: true, .. } => Err(JobSpecError::StopTiles),
            _ => Ok(()),
        }
    }
}

impl FrameRange {
    /// `first..=last` in steps of `step`.
    pub fn new(first: u32, last: u32, step: u32) -> Result<Self, JobSpecError> {
        if first <= last && step > 0 {
            Ok(Self { first, last, step })
        } else {
            Err(JobSpecError::Frames { first, last, step })
        }
    }

    /// A single frame.
    pub fn single(frame: u32) -> Self {
        Self { first: frame, last: frame, step: 1 }
    }

    /// First frame.
    pub fn first(self) -> u32 {
        self.first
    }

    /// Bound of the last frame, inclusive.
    pub fn last(self) -> u32 {
        self.last
    }

    /// Distance between frames, >= 1.
    pub fn step(self) -> u32 {
        self.step
    }

    /// The frames in order.
    pub fn iter(self) -> impl Iterator<Item = FrameIndex> + Clone {
        (self.first..=self.last).step_by(self.step as usize).map(FrameIndex)
    }

    /// How many frames.
    pub fn count(self) -> u64 {
        u64::from((self.last - self.first) / self.step) + 1
    }

    /// The frame at `position`, counted from 0.
    pub fn get(self, position: u32) -> Option<FrameIndex> {
        let frame = self.first.checked_add(position.checked_mul(self.step)?)?;
        (frame <= self.last).then_some(FrameIndex(frame))
    }

    /// Where `frame` stands, counted from 0; none when it is not one of these.
    pub fn position(self, frame: FrameIndex) -> Option<u32> {
        let distance = frame.0.checked_sub(self.first)?;
        (frame.0 <= self.last && distance.is_multiple_of(self.step)).then(|| distance / self.step)
    }
}

impl std::str::FromStr for FrameRange {
    type Err = JobSpecError;

    fn from_str(text: &str) -> Result<Self, JobSpecError> {
        let syntax = || JobSpecError::FrameSyntax(text.to_owned());
        let number = |part: &str| part.parse::<u32>().map_err(|_| syntax());
        let (range, step) = match text.split_once('x') {
            Some((range, step)) => (range, number(step)?),
            None => (text, 1),
        };
        match range.split_once('-') {
            Some((first, last)) => Self::new(number(first)?, number(last)?, step),
            None => Self::new(number(range)?, number(range)?, step),
        }
    }
}

/// What a user asks: a scene, how to render it, and how much of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobSpec {
    /// For people.
    pub name: String,
    /// Digest of the scene's snapshot.
    pub scene: SceneId,
    /// How to render.
    pub settings: Settings,
    /// Which pictures.
    pub frames: FrameRange,
    /// Samples per pixel, at most.
    pub spp: u64,
    /// When a frame ends with fewer.
    #[serde(default)]
    pub stop: Stop,
    /// Whether finished frames carry the variance of every pixel.
    #[serde(default)]
    pub variance: bool,
    /// Side of a tile in pixels.
    pub tile_side: u32,
    /// Jobs of higher priority go first.
    pub priority: i32,
}

impl JobSpec {
    /// Checks every number against its range.
    pub fn validate(&self) -> Result<(), JobSpecError> {
        self.resolution()?;
        SampleRange::new(0..self.spp)?;
        let frames = self.frames;
        FrameRange::new(frames.first, frames.last, frames.step)?;
        if self.tile_side == 0 {
            return Err(JobSpecError::Tile);
        }
        if !(self.settings.fps.is_finite() && self.settings.fps > 0.0) {
            return Err(JobSpecError::FrameRate(self.settings.fps));
        }
        self.stop.validate()
    }

    /// Blocks of sample indices from the first sample to the last, each of which every tile of a frame gets before any tile
    /// gets the next one. A frame may end after any of them.
    pub fn rounds(&self) -> Result<Vec<SampleBlock>, JobSpecError> {
        Ok(rounds::rounds(self.spp, !self.stop.is_never())?)
    }

    /// Width and height of every frame.
    pub fn resolution(&self) -> Result<Resolution, JobSpecError> {
        Ok(Resolution::new(self.settings.width, self.settings.height)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_ranges_read_as_they_are_written() {
        let frames = |text: &str| {
            text.parse::<FrameRange>().map(|range| range.iter().map(|f| f.0).collect::<Vec<_>>())
        };
        assert_eq!(frames("5"), Ok(vec![5]));
        assert_eq!(frames("1-4"), Ok(vec![1, 2, 3, 4]));
        assert_eq!(frames("1-8x3"), Ok(vec![1, 4, 7]));
        assert_eq!("1-8x3".parse::<FrameRange>().unwrap().count(), 3);
        assert_eq!(frames("4294967295"), Ok(vec![u32::MAX]));
        let range = "3-9x3".parse::<FrameRange>().unwrap();
        assert_eq!(
            [0, 2, 3, u32::MAX].map(|position| range.get(position).map(|f| f.0)),
            [Some(3), Some(9), None, None]
        );
        assert_eq!(
            [2, 3, 4, 9, 12].map(|frame| range.position(FrameIndex(frame))),
            [None, Some(0), None, Some(2), None]
        );
        for text in ["", "4-1", "1-4x0", "-3", "1-", "a", "1-2-3", "99999999999"] {
            assert!(frames(text).is_err(), "{text:?} is no frame range");
        }
    }
}
