//! Which tokens there are, and what has become of them: one small file each, so that the coordinator and whoever makes or
//! revokes tokens beside it never write the same file.
//!
//! ```text
//! tokens/<id>.json      what the token is good for, and the digest of its secret
//! tokens/<id>.use.<n>   its n-th use
//! tokens/<id>.revoked   it is good for nothing any more, nor are the certificates that it was exchanged for
//! ```

use crate::files::{self, TrustError};
use crate::{Role, Token, TokenId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// What is kept of a token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TokenRecord {
    /// What it makes of its holder.
    pub role: Role,
    /// When it was made, in seconds since 1970.
    pub created: u64,
    /// When it ceases to be good, in seconds since 1970.
    pub expires: u64,
    /// How often it may be exchanged; any number of times when there is none.
    pub uses_max: Option<u32>,
    /// BLAKE3 of its secret.
    digest: String,
}

/// A token as it is shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenView {
    /// Names it.
    pub id: TokenId,
    /// What is kept of it.
    pub record: TokenRecord,
    /// How often it was exchanged.
    pub uses: u32,
    /// Whether it was taken back.
    pub revoked: bool,
}

/// Why a token is refused.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// Not one of ours. Does not tell whether the name or the secret is wrong.
    #[error("the token is not known here: ask for a new one")]
    Unknown,
    /// Too old.
    #[error("token {0} has expired: ask for a new one")]
    Expired(TokenId),
    /// Taken back.
    #[error("token {0} was revoked")]
    Revoked(TokenId),
    /// Exchanged as often as it may be.
    #[error("token {0} was used before and cannot be used again: ask for a new one")]
    Used(TokenId),
    /// The files cannot be read or written.
    #[error(transparent)]
    Files(#[from] TrustError),
}

/// All tokens of an authority.
#[derive(Clone, Debug)]
pub struct TokenBook {
    folder: PathBuf,
}

fn seconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

impl TokenBook {
    /// In `folder`, which is made if it is not there.
    pub(crate) fn open(folder: &Path) -> Result<Self, TrustError> {
        files::make_folder(folder)?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Makes a token that is good for `lifetime` from `now` on, for `uses_max` exchanges if that is given.
    pub fn create(
        &self,
        role: Role,
        now: SystemTime,
        lifetime: Duration,
        uses_max: Option<u32>,
    ) -> Result<Token, TrustError> {
        let token = Token::random();
        let record = TokenRecord {
            role,
            created: seconds(now),
            expires: seconds(now).saturating_add(lifetime.as_secs()),
            uses_max,
            digest: token.digest().to_hex().to_string(),
        };
        let json = serde_json::to_vec_pretty(&record).expect("plain data serialises");
        files::write(&self.path(token.id, "json"), &json)?;
        Ok(token)
    }

    /// Every token, the oldest first.
    pub fn list(&self) -> Result<Vec<TokenView>, TrustError> {
        let names = self.names()?;
        let mut views = Vec::new();
        for id in names.iter().filter_map(|name| name.strip_suffix(".json")?.parse::<TokenId>().ok()) {
            let Some(record) = self.record(id)? else { continue };
            let prefix = format!("{id}.use.");
            let uses = names.iter().filter(|name| name.starts_with(&prefix)).count() as u32;
            views.push(TokenView { id, record, uses, revoked: self.is_revoked(id) });
        }
        views.sort_by_key(|view| (view.record.created, view.id));
        Ok(views)
    }

    /// Takes a token back, with all certificates that it was exchanged for; whether it is known.
    pub fn revoke(&self, id: TokenId) -> Result<bool, TrustError> {
        if self.record(id)?.is_none() {
            return Ok(false);
        }
        files::write(&self.path(id, "revoked"), b"")?;
        Ok(true)
    }

    /// Every token that was taken back.
    pub fn revoked(&self) -> Result<BTreeSet<TokenId>, TrustError> {
        Ok(self.names()?.iter().filter_map(|name| name.strip_suffix(".revoked")?.parse().ok()).collect())
    }

    /// Uses a token once; what it makes of its holder.
    pub fn redeem(&self, token: &Token, now: SystemTime) -> Result<Role, TokenError> {
        let record = self.record(token.id)?.ok_or(TokenError::Unknown)?;
        let kept = blake3::Hash::from_hex(&record.digest)
            .map_err(|err| TrustError::damaged(&self.path(token.id, "json"), err))?;
        if kept != token.digest() {
            return Err(TokenError::Unknown);
        }
        if self.is_revoked(token.id) {
            return Err(TokenError::Revoked(token.id));
        }
        if seconds(now) >= record.expires {
            return Err(TokenError::Expired(token.id));
        }
        if let Some(uses_max) = record.uses_max {
            self.take_use(token.id, uses_max)?;
        }
        Ok(record.role)
    }

    /// Claims one of a token's uses. Two that come at the same moment never get the same one.
    fn take_use(&self, id: TokenId, uses_max: u32) -> Result<(), TokenError> {
        for number in 0..uses_max {
            let path = self.path(id, &format!("use.{number}"));
            match std::fs::OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => {
                    return file.sync_all().map_err(|error| TrustError::file(&path, error).into());
                }
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(TrustError::file(&path, error).into()),
            }
        }
        Err(TokenError::Used(id))
    }

    fn record(&self, id: TokenId) -> Result<Option<TokenRecord>, TrustError> {
        let path = self.path(id, "json");
        let Some(bytes) = files::read(&path)? else { return Ok(None) };
        serde_json::from_slice(&bytes).map(Some).map_err(|err| TrustError::damaged(&path, err))
    }

    fn is_revoked(&self, id: TokenId) -> bool {
        self.path(id, "revoked").exists()
    }

    fn path(&self, id: TokenId, kind: &str) -> PathBuf {
        self.folder.join(format!("{id}.{kind}"))
    }

    fn names(&self) -> Result<Vec<String>, TrustError> {
        let entries =
            std::fs::read_dir(&self.folder).map_err(|error| TrustError::file(&self.folder, error))?;
        Ok(entries.flatten().filter_map(|entry| entry.file_name().into_string().ok()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    fn book() -> (tempfile::TempDir, TokenBook) {
        let folder = tempfile::tempdir().unwrap();
        let book = TokenBook::open(&folder.path().join("tokens")).unwrap();
        (folder, book)
    }

    #[test]
    fn a_token_is_good_until_it_expires() {
        let (_folder, book) = book();
        let now = SystemTime::now();
        let token = book.create(Role::Worker, now, HOUR, None).unwrap();
        for _ in 0..3 {
            assert_eq!(book.redeem(&token, now).unwrap(), Role::Worker);
        }
        let late = book.redeem(&token, now + HOUR).unwrap_err();
        assert!(matches!(late, TokenError::Expired(id) if id == token.id));
    }

    #[test]
    fn a_token_for_one_use_is_good_once() {
        let (_folder, book) = book();
        let token = book.create(Role::Submitter, SystemTime::now(), HOUR, Some(1)).unwrap();
        let outcomes: Vec<_> = std::thread::scope(|scope| {
            let redeem = || book.redeem(&token, SystemTime::now());
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(redeem)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert_eq!(outcomes.iter().filter(|outcome| outcome.is_ok()).count(), 1);
        assert!(
            outcomes
                .iter()
                .flat_map(|outcome| outcome.as_ref().err())
                .all(|err| matches!(err, TokenError::Used(_)))
        );
        assert_eq!(book.list().unwrap()[0].uses, 1);
    }

    #[test]
    fn a_revoked_token_is_good_for_nothing() {
        let (_folder, book) = book();
        let now = SystemTime::now();
        let (token, other) = (
            book.create(Role::Admin, now, HOUR, None).unwrap(),
            book.create(Role::Admin, now, HOUR, None).unwrap(),
        );
        assert!(book.revoke(token.id).unwrap());
        assert!(!book.revoke(TokenId::random()).unwrap());
        assert!(matches!(book.redeem(&token, now), Err(TokenError::Revoked(_))));
        assert!(book.redeem(&other, now).is_ok());
        assert_eq!(book.revoked().unwrap(), BTreeSet::from([token.id]));
    }

    #[test]
    fn what_is_kept_does_not_give_the_token_away() {
        let (folder, book) = book();
        let token = book.create(Role::Worker, SystemTime::now(), HOUR, None).unwrap();
        let path = folder.path().join("tokens").join(format!("{}.json", token.id));
        let kept = std::fs::read_to_string(path).unwrap();
        assert!(!kept.contains(&token.text()[21..]));
        // The right name with another secret is as unknown as a wrong name.
        let forged: Token =
            format!("tessera-{}-{}", token.id, &Token::random().text()[21..]).parse().unwrap();
        assert!(matches!(book.redeem(&forged, SystemTime::now()), Err(TokenError::Unknown)));
        assert!(matches!(book.redeem(&Token::random(), SystemTime::now()), Err(TokenError::Unknown)));
    }
}
