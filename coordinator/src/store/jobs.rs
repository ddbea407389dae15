//! Jobs in the store: what was asked, by whom, what has become of it, and that it was forgotten.

use super::objects::{create, list, put};
use super::{READS, Store, StoreError, job_path};
use farm_job::{JobId, JobSpec, JobState};
use farm_trust::TokenId;
use futures::{StreamExt, TryStreamExt};
use object_store::path::Path;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::atomic::Ordering;
use tracing::info;

/// A job as it is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredJob {
    /// Its name.
    pub job: JobId,
    /// What was asked; its priority is the present one.
    pub spec: JobSpec,
    /// Whose it is: all certificates that go back to one token are one owner. None: it came over a line that is open to all.
    pub owner: Option<TokenId>,
    /// Where it is in its life.
    pub state: JobState,
    /// Why it failed.
    pub reason: Option<String>,
}

/// `job.json`, never changed until the job is forgotten.
#[derive(Serialize, Deserialize)]
struct Description {
    #[serde(flatten)]
    spec: JobSpec,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    owner: Option<String>,
}

/// What has become of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fate {
    /// Where it is in its life.
    pub state: JobState,
    /// Why it failed.
    pub reason: Option<String>,
    /// Its present priority.
    pub priority: i32,
}

impl StoredJob {
    /// What has become of it.
    pub fn fate(&self) -> Fate {
        Fate { state: self.state, reason: self.reason.clone(), priority: self.spec.priority }
    }
}

/// What there is in a job's folder.
enum Found {
    Job(Box<StoredJob>),
    /// It was forgotten, but not all of it is gone; or it was never acknowledged.
    Remains(JobId),
}

impl Store {
    /// Keeps a new job under the next number, which no job ever had.
    pub async fn create_job(&self, spec: &JobSpec, owner: Option<TokenId>) -> Result<JobId, StoreError> {
        let description = Description { spec: spec.clone(), owner: owner.map(|owner| owner.to_string()) };
        let json = serde_json::to_vec_pretty(&description).expect("plain data serialises");
        loop {
            let job = JobId(self.last_job.fetch_add(1, Ordering::Relaxed) + 1);
            self.turn.check(&self.objects).await?;
            let created = create(&*self.objects.durable, &description_path(job), json.clone()).await?;
            self.turn.confirm(&self.objects).await?;
            // A number that was used before this coordinator looked.
            if created {
                return Ok(job);
            }
        }
    }

    /// Keeps what has become of a job.
    pub async fn put_fate(&self, job: JobId, fate: &Fate) -> Result<(), StoreError> {
        let folder = job_path(job).join("state");
        let former = list(&*self.objects.durable, &folder).await?;
        let json = serde_json::to_vec_pretty(fate).expect("plain data serialises");
        self.keep(&folder.join(self.fresh_name("json")), json).await?;
        self.remove(former).await;
        Ok(())
    }

    /// Every job, by number. What is left of forgotten ones goes.
    pub async fn jobs(&self) -> Result<Vec<StoredJob>, StoreError> {
        let folder = Path::from("jobs");
        let found = self.objects.durable.list_with_delimiter(Some(&folder)).await;
        let found = found.map_err(|error| StoreError::object(&folder, &error))?;
        let numbers: BTreeSet<JobId> = found
            .common_prefixes
            .iter()
            .filter_map(|path| path.filename()?.parse().ok().map(JobId))
            .collect();
        self.last_job.fetch_max(numbers.last().map_or(0, |job| job.0), Ordering::Relaxed);
        let found = futures::stream::iter(numbers).map(|job| self.find_job(job)).buffered(READS);
        let mut jobs = Vec::new();
        for found in found.try_collect::<Vec<_>>().await? {
            match found {
                Found::Job(job) => jobs.push(*job),
                Found::Remains(job) => self.remove_job(job).await?,
            }
        }
        Ok(jobs)
    }

    async fn find_job(&self, job: JobId) -> Result<Found, StoreError> {
        let path = description_path(job);
        let Some(Description { spec, owner }) = self.read_json::<Option<Description>>(&path).await?.flatten()
        else {
            return Ok(Found::Remains(job));
        };
        let damaged = |fault: farm_trust::TokenTextError| StoreError::Damaged {
            path: path.to_string(),
            fault: fault.to_string(),
        };
        let owner = owner.map(|owner| owner.parse()).transpose().map_err(damaged)?;
        let mut stored = StoredJob { job, spec, owner, state: JobState::Running, reason: None };
        let states = list(&*self.objects.durable, &job_path(job).join("state")).await?;
        if let Some(latest) = states.iter().max()
            && let Some(Fate { state, reason, priority }) = self.read_json(latest).await?
        {
            (stored.state, stored.reason, stored.spec.priority) = (state, reason, priority);
        }
        Ok(Found::Job(Box::new(stored)))
    }

    /// Forgets a job: from now on there is none of its number, also after a crash. [`Self::remove_job`] makes room.
    pub async fn forget_job(&self, job: JobId) -> Result<(), StoreError> {
        self.keep(&description_path(job), "null").await
    }

    /// Removes all that is there of a forgotten job. Of the last one its number stays, so that no other job gets it.
    pub async fn remove_job(&self, job: JobId) -> Result<(), StoreError> {
        self.turn.check(&self.objects).await?;
        let objects = &*self.objects.durable;
        let description = description_path(job);
        let rest = list(objects, &job_path(job)).await?.into_iter().filter(|path| *path != description);
        let rest: Vec<Path> = rest.collect();
        if !rest.is_empty() {
            info!(%job, objects = rest.len(), "removing a forgotten job");
            self.remove(rest).await;
        }
        if job.0 < self.last_job.load(Ordering::Relaxed) {
            self.remove(vec![description]).await;
        } else {
            put(objects, &description, "null".into()).await?;
        }
        Ok(())
    }
}

fn description_path(job: JobId) -> Path {
    job_path(job).join("job.json")
}
