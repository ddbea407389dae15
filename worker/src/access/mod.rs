//! How programs of the farm reach a coordinator: by themselves on the same host, with a certificate from anywhere.

mod args;
mod dial;
mod keys;

pub use args::AccessArgs;
pub use dial::{DialError, dial, refused_by_tls};
pub(crate) use dial::{root_cause, sentence, tuned};

use keys::Keys;
use std::sync::Arc;

/// By which right a coordinator is spoken to.
#[derive(Clone, Debug)]
pub enum Access {
    /// Unencrypted, as nobody in particular.
    Plain,
    /// With a certificate, over TLS.
    Secure(Arc<Keys>),
}
