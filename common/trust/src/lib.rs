//! Who may do what on a farm that others can reach.
//!
//! A farm has an authority of its own: a key that signs certificates and never leaves its folder. Whoever is to join gets a
//! token, and the fingerprint of the authority by which to know the right coordinator; the token is exchanged for a
//! certificate once, over a key pair that the newcomer made and keeps. From then on both sides show certificates. A
//! certificate says which role its holder has and which token it goes back to, so that revoking the token revokes them all.
//!
//! Never opens a connection, and never writes a secret into an error, a log line or a `Debug` text.

mod authority;
mod files;
mod fingerprint;
mod holder;
mod identity;
mod own_certificate;
mod role;
mod state_folder;
mod tls;
mod token;
mod token_book;

pub use authority::{Authority, HOLDER_LIFETIME};
pub use files::TrustError;
pub use fingerprint::{Fingerprint, FingerprintError};
pub use holder::{Holder, HolderError};
pub use identity::{Identity, Request};
pub use role::{Role, UnknownRole};
pub use state_folder::state_folder;
pub use tls::{SERVER_NAME, joining_config};
pub use token::{Token, TokenId, TokenTextError};
pub use token_book::{TokenBook, TokenError, TokenRecord, TokenView};
