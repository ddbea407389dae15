//! Work that would hold up messages.

use tokio::runtime::{Handle, RuntimeFlavor};

/// Does work away from the threads that answer messages. On a runtime of a single thread, as simulations have it, there is
/// no other thread to leave it to, and it is done at once.
pub async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    if Handle::current().runtime_flavor() == RuntimeFlavor::CurrentThread {
        return work();
    }
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => value,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => {
                unreachable!("blocking work is not cancelled once it runs, and the runtime outlives it")
            }
        },
    }
}
