//! Who may call what. Whatever is not listed here nobody may call but an admin.

use farm_trust::{Holder, Role, TokenId};
use std::net::SocketAddr;
use std::time::SystemTime;

/// Who is at the other end of a connection.
#[derive(Clone, Debug)]
pub struct Peer {
    /// Where from.
    pub address: SocketAddr,
    /// As what.
    pub standing: Standing,
}

impl Peer {
    /// Who made a call.
    pub fn of<T>(request: &tonic::Request<T>) -> Result<Self, tonic::Status> {
        let peer = request.extensions().get::<Self>().cloned();
        peer.ok_or_else(|| tonic::Status::internal("the connection does not say whose it is"))
    }
}

/// As what someone is connected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Over a line that is open to whoever can reach it: by default, all users of this host.
    Open,
    /// Over TLS, without a certificate.
    Stranger,
    /// Over TLS, with a certificate of this farm.
    Known(Holder),
}

impl Standing {
    /// Whose it is what somebody submits: a person has one token, and may have several hosts that joined with it.
    pub fn owner(&self) -> Option<TokenId> {
        match self {
            Self::Open | Self::Stranger => None,
            Self::Known(holder) => Some(holder.token),
        }
    }

    /// Whether nothing that somebody brings or asks is anybody else's business.
    pub fn is_admin(&self) -> bool {
        matches!(self, Self::Known(holder) if holder.role == Role::Admin)
    }

    /// Whether somebody may change and fetch what is `owner`'s. Whoever reaches an open line may, as all are one there.
    pub fn may_touch(&self, owner: Option<TokenId>) -> bool {
        match self {
            Self::Open => true,
            Self::Stranger => false,
            Self::Known(holder) => holder.role == Role::Admin || owner == Some(holder.token),
        }
    }
}

/// Why a call is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// No certificate.
    #[error("this farm knows nobody without a certificate: join with a token")]
    Stranger,
    /// The certificate ran out while it was in use.
    #[error("the certificate has expired: join again, with a new token")]
    Expired,
    /// What the certificate goes back to was taken back.
    #[error("token {0} was revoked, and with it this certificate")]
    Revoked(TokenId),
    /// The wrong kind of certificate.
    #[error("a certificate for {found}s does not allow this call: it takes one for {needed}s")]
    Role {
        /// What the caller is.
        found: Role,
        /// What it would have to be.
        needed: Role,
    },
}

/// Who may call a method.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Rule {
    Anyone,
    AnyHolder,
    Holders(Role),
}

/// The services, and the methods that differ from the rest of their service.
const RULES: [(&str, &str, Rule); 7] = [
    ("farm.v1.Enrolment", "Enrol", Rule::Anyone),
    ("farm.v1.Control", "Drain", Rule::Holders(Role::Admin)),
    ("farm.v1.Control", "Forgive", Rule::Holders(Role::Admin)),
    ("farm.v1.Control", "*", Rule::Holders(Role::Submitter)),
    ("farm.v1.Farm", "*", Rule::Holders(Role::Worker)),
    ("grpc.health.v1.Health", "*", Rule::AnyHolder),
    ("grpc.reflection.v1.ServerReflection", "*", Rule::AnyHolder),
];

/// The rule for a path such as `/farm.v1.Farm/Work`.
fn rule(path: &str) -> Rule {
    let (service, method) = path.trim_start_matches('/').split_once('/').unwrap_or((path, ""));
    let fits = |(rule_service, rule_method, _): &&(&str, &str, Rule)| {
        *rule_service == service && (*rule_method == method || *rule_method == "*")
    };
    RULES.iter().find(fits).map_or(Rule::Holders(Role::Admin), |(_, _, rule)| *rule)
}

/// Whether whoever is connected as `standing` may call `path` at `now`; `is_revoked` knows the tokens.
pub fn permit(
    standing: &Standing,
    path: &str,
    now: SystemTime,
    is_revoked: impl FnOnce(&Holder) -> bool,
) -> Result<(), Refusal> {
    let holder = match (standing, rule(path)) {
        (Standing::Open, _) | (Standing::Stranger, Rule::Anyone) => return Ok(()),
        (Standing::Stranger, _) => return Err(Refusal::Stranger),
        (Standing::Known(holder), _) => holder,
    };
    if holder.expires <= now {
        return Err(Refusal::Expired);
    }
    if is_revoked(holder) {
        return Err(Refusal::Revoked(holder.token));
    }
    match rule(path) {
        Rule::Holders(needed) if holder.role != needed && holder.role != Role::Admin => {
            Err(Refusal::Role { found: holder.role, needed })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn holder(role: Role) -> Holder {
        let issued = SystemTime::now();
        Holder { role, token: TokenId::LOCAL, issued, expires: issued + Duration::from_secs(60) }
    }

    fn may(standing: &Standing, path: &str) -> bool {
        permit(standing, path, SystemTime::now(), |_| false).is_ok()
    }

    #[test]
    fn roles_are_separate() {
        let known = |role| Standing::Known(holder(role));
        let (worker, submitter, admin) = (known(Role::Worker), known(Role::Submitter), known(Role::Admin));
        let table = [
            ("/farm.v1.Farm/Work", [true, false, true]),
            ("/farm.v1.Farm/GetScene", [true, false, true]),
            ("/farm.v1.Control/Submit", [false, true, true]),
            ("/farm.v1.Control/Fetch", [false, true, true]),
            ("/farm.v1.Control/Drain", [false, false, true]),
            ("/farm.v1.Control/Forgive", [false, false, true]),
            ("/grpc.health.v1.Health/Check", [true, true, true]),
            ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", [true, true, true]),
            ("/farm.v1.Enrolment/Enrol", [true, true, true]),
            ("/farm.v1.Unheard/Of", [false, false, true]),
            ("nonsense", [false, false, true]),
            ("/farm.v1.Control/Drain/x", [false, true, true]),
        ];
        for (path, expected) in table {
            assert_eq!([may(&worker, path), may(&submitter, path), may(&admin, path)], expected, "{path}");
            assert_eq!(may(&Standing::Stranger, path), path.ends_with("/Enrol"), "{path}");
            assert!(may(&Standing::Open, path));
        }
    }

    #[test]
    fn what_is_somebodys_is_for_its_owner_and_admins() {
        let token = |text: &str| text.parse::<TokenId>().unwrap();
        let known = |role, token| Standing::Known(Holder { token, ..holder(role) });
        let (ann, bob) = (token("00000000000a"), token("00000000000b"));
        for (who, of_ann, of_nobody) in [
            (known(Role::Submitter, ann), true, false),
            (known(Role::Submitter, bob), false, false),
            (known(Role::Admin, bob), true, true),
            (Standing::Open, true, true),
            (Standing::Stranger, false, false),
        ] {
            assert_eq!((who.may_touch(Some(ann)), who.may_touch(None)), (of_ann, of_nobody), "{who:?}");
        }
        assert_eq!(known(Role::Submitter, ann).owner(), Some(ann));
        assert_eq!(Standing::Open.owner(), None);
    }

    #[test]
    fn a_certificate_is_good_until_it_expires_or_is_revoked() {
        let admin = Standing::Known(holder(Role::Admin));
        let path = "/farm.v1.Control/Status";
        let late = SystemTime::now() + Duration::from_secs(61);
        assert_eq!(permit(&admin, path, late, |_| false), Err(Refusal::Expired));
        let revoked = permit(&admin, path, SystemTime::now(), |_| true);
        assert_eq!(revoked, Err(Refusal::Revoked(TokenId::LOCAL)));
    }
}
