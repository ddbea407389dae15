//! Calls to a coordinator beside the work stream: what a job is, and what its scene holds.

use bytes::BytesMut;
use farm_job::{JobId, JobSpec};
use farm_proto::convert::{ConvertError, Heartbeat};
use farm_proto::v1::{self, farm_client::FarmClient};
use farm_proto::{MESSAGE_BYTES_MAX, v1::SceneChunk};
use farm_scene::SceneId;
use std::time::Duration;
use tonic::transport::Channel;
use tonic::{Code, Status};

/// Largest scene snapshot that is accepted, so that a wrong length cannot exhaust the memory.
const SCENE_BYTES_MAX: u64 = 16 << 30;

/// Times a call is tried again when the connection fails; the connection itself is remade elsewhere.
const RETRIES: u32 = 8;

/// Something that a coordinator could not give.
#[derive(Debug, thiserror::Error)]
pub enum FetchError {
    /// The call failed.
    #[error("coordinator: {}", .0.message())]
    Status(Box<Status>),
    /// The answer makes no sense.
    #[error("coordinator sent nonsense: {0}")]
    Convert(#[from] ConvertError),
    /// More than this worker may hold.
    #[error(
        "scene {scene} has {bytes} bytes and takes up to twice that while it is read; this worker may use {allowed}: give it more with --memory"
    )]
    TooLarge {
        /// Which scene.
        scene: SceneId,
        /// Its size.
        bytes: u64,
        /// What may be used in all.
        allowed: u64,
    },
    /// Chunks that do not follow one another, or never end.
    #[error("scene {scene} came in disorder: {fault}")]
    Disorder {
        /// Which scene.
        scene: SceneId,
        /// What was wrong.
        fault: String,
    },
    /// Other bytes than the name promises.
    #[error("scene {0} did not arrive as it was sent: its digest differs")]
    Digest(SceneId),
    /// The right bytes, but no scene.
    #[error("scene {scene}: {fault}")]
    Snapshot {
        /// Which scene.
        scene: SceneId,
        /// What was wrong.
        fault: String,
    },
}

impl From<Status> for FetchError {
    fn from(status: Status) -> Self {
        Self::Status(Box::new(status))
    }
}

/// A coordinator's side of one connection.
#[derive(Clone)]
pub struct Client {
    farm: FarmClient<Channel>,
}

impl Client {
    /// Speaks over `channel`.
    pub fn new(channel: Channel) -> Self {
        let farm = FarmClient::new(channel)
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        Self { farm }
    }

    /// The stub itself.
    pub fn stub(&self) -> FarmClient<Channel> {
        self.farm.clone()
    }

    /// A sign of life; not heard is not tried again, the next one is due soon.
    pub async fn beat(&self, beat: Heartbeat) -> Result<(), FetchError> {
        self.stub().beat(v1::Heartbeat::from(beat)).await?;
        Ok(())
    }

    /// What a granted unit belongs to.
    pub async fn job(&self, job: JobId) -> Result<JobSpec, FetchError> {
        let mut attempt = 0;
        loop {
            match self.stub().get_job(v1::GetJobRequest { job: job.0 }).await {
                Ok(answer) => return Ok(answer.into_inner().try_into()?),
                Err(status) => pause_or_give_up(status, &mut attempt).await?,
            }
        }
    }

    /// The bytes of a scene, verified, if reading it takes at most `memory` bytes. Goes on where it was interrupted.
    pub async fn scene(&self, scene: SceneId, memory: u64) -> Result<BytesMut, FetchError> {
        let mut bytes = BytesMut::new();
        let mut attempt = 0;
        while let Err(fault) = self.scene_from(scene, memory, &mut bytes).await {
            match fault {
                FetchError::Status(status) => pause_or_give_up(*status, &mut attempt).await?,
                fault => return Err(fault),
            }
        }
        if SceneId::of(&bytes) != scene {
            return Err(FetchError::Digest(scene));
        }
        Ok(bytes)
    }

    /// Appends what is missing.
    async fn scene_from(&self, scene: SceneId, memory: u64, bytes: &mut BytesMut) -> Result<(), FetchError> {
        let request = v1::GetSceneRequest { scene: Some(scene.into()), offset: bytes.len() as u64 };
        let mut chunks = self.stub().get_scene(request).await?.into_inner();
        let mut total = None;
        while let Some(chunk) = chunks.message().await? {
            fits(scene, chunk.total, memory)?;
            append(scene, bytes, &chunk)?;
            total = Some(chunk.total);
        }
        match total {
            Some(total) if bytes.len() as u64 == total => Ok(()),
            // The stream ended well, but early: ask for the rest.
            Some(_) => Err(Status::unavailable("the scene broke off").into()),
            None => Err(FetchError::Disorder { scene, fault: "no chunk came".to_owned() }),
        }
    }
}

/// Bytes and decoded scene are in memory at the same time while it is read.
pub(crate) fn fits(scene: SceneId, bytes: u64, allowed: u64) -> Result<(), FetchError> {
    if bytes.saturating_mul(2) > allowed {
        return Err(FetchError::TooLarge { scene, bytes, allowed });
    }
    Ok(())
}

fn append(scene: SceneId, bytes: &mut BytesMut, chunk: &SceneChunk) -> Result<(), FetchError> {
    let disorder = |fault| Err(FetchError::Disorder { scene, fault });
    if chunk.total > SCENE_BYTES_MAX {
        return disorder(format!(
            "{} bytes are more than the {SCENE_BYTES_MAX} a scene may have",
            chunk.total
        ));
    }
    if chunk.offset != bytes.len() as u64 || chunk.offset + chunk.data.len() as u64 > chunk.total {
        return disorder(format!("bytes from {} on after {}", chunk.offset, bytes.len()));
    }
    bytes.extend_from_slice(&chunk.data);
    Ok(())
}

/// A failed call arrives as a status: what may pass is worth another try.
async fn pause_or_give_up(status: Status, attempt: &mut u32) -> Result<(), FetchError> {
    let may_pass = matches!(
        status.code(),
        Code::Unavailable | Code::Unknown | Code::Internal | Code::Cancelled | Code::DeadlineExceeded
    );
    if !may_pass || *attempt >= RETRIES {
        return Err(status.into());
    }
    *attempt += 1;
    tokio::time::sleep(Duration::from_millis(100 << (*attempt).min(5))).await;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(total: u64, offset: u64, len: usize) -> SceneChunk {
        SceneChunk { total, offset, data: vec![7; len].into() }
    }

    #[test]
    fn scenes_beyond_the_memory_are_refused_with_the_first_chunk() {
        assert!(fits(SceneId([0; 32]), 500, 1000).is_ok());
        let refused = fits(SceneId([0; 32]), 501, 1000).unwrap_err().to_string();
        assert!(refused.contains("501 bytes") && refused.contains("--memory"), "{refused}");
    }

    #[test]
    fn chunks_must_follow_one_another() {
        let scene = SceneId([0; 32]);
        let mut bytes = BytesMut::new();
        append(scene, &mut bytes, &chunk(10, 0, 4)).unwrap();
        for wrong in [chunk(10, 0, 4), chunk(10, 5, 1), chunk(10, 4, 7), chunk(u64::MAX, 4, 1)] {
            assert!(append(scene, &mut bytes, &wrong).is_err());
        }
        append(scene, &mut bytes, &chunk(10, 4, 6)).unwrap();
        assert_eq!(bytes.len(), 10);
    }
}
