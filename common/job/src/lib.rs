//! What a user asks of the farm. Plain values, checked on the way in.

mod ids;
mod rounds;
mod spec;
mod state;

pub use ids::{Digest, DigestError, JobId, LeaseId, WorkerId};
pub use spec::{FrameRange, JobSpec, JobSpecError, Stop};
pub use state::JobState;
