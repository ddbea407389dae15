//! Frames that end when their time is over.

use farm_film::FrameIndex;
use farm_job::JobId;
use std::collections::BTreeMap;
use std::time::Instant;

/// When open frames are to end, and with how many samples they could.
#[derive(Debug, Default)]
pub struct Clocks {
    frames: BTreeMap<(JobId, FrameIndex), Clock>,
}

#[derive(Debug, Default)]
struct Clock {
    due: Option<Instant>,
    /// Samples per pixel that every tile has.
    spp: Option<u64>,
}

impl Clocks {
    /// A frame is to end at `due`, or earlier if that was said before. Whether it was not.
    pub fn set(&mut self, job: JobId, frame: FrameIndex, due: Instant) -> bool {
        let clock = self.frames.entry((job, frame)).or_default();
        let former = clock.due;
        clock.due = Some(former.map_or(due, |before| before.min(due)));
        former.is_none()
    }

    /// Every tile of a frame has `[0, spp)`.
    pub fn round(&mut self, job: JobId, frame: FrameIndex, spp: u64) {
        self.frames.entry((job, frame)).or_default().spp = Some(spp);
    }

    /// A frame has ended.
    pub fn end(&mut self, job: JobId, frame: FrameIndex) {
        self.frames.remove(&(job, frame));
    }

    /// All frames of a job have ended.
    pub fn end_job(&mut self, job: JobId) {
        self.frames.retain(|(other, _), _| *other != job);
    }

    /// When the next frame ends. One that is due ends with its first round, however late that is: less is no picture.
    pub fn next(&self) -> Option<Instant> {
        self.frames.values().filter_map(|clock| clock.spp.and(clock.due)).min()
    }

    /// Frames whose time is over, with their samples per pixel. They are forgotten.
    pub fn take_due(&mut self, now: Instant) -> Vec<(JobId, FrameIndex, u64)> {
        let due = |clock: &Clock| clock.due.filter(|due| *due <= now).and(clock.spp);
        let over: Vec<_> = self
            .frames
            .iter()
            .filter_map(|((job, frame), clock)| Some((*job, *frame, due(clock)?)))
            .collect();
        for (job, frame, _) in &over {
            self.end(*job, *frame);
        }
        over
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_frame_ends_with_the_last_complete_round() {
        let (job, frame, start) = (JobId(1), FrameIndex(3), Instant::now());
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut clocks = Clocks::default();
        assert!(clocks.set(job, frame, at(20)));
        assert!(!clocks.set(job, frame, at(10)));
        assert_eq!(clocks.next(), None, "nothing is complete");
        assert!(clocks.take_due(at(11)).is_empty());
        clocks.round(job, frame, 16);
        clocks.round(job, frame, 32);
        assert_eq!(clocks.next(), Some(at(10)));
        assert!(clocks.take_due(at(9)).is_empty());
        assert_eq!(clocks.take_due(at(10)), [(job, frame, 32)]);
        assert!(clocks.take_due(at(30)).is_empty());
    }
}
