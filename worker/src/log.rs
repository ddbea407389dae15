//! Where log lines go: standard error, so that standard output stays an answer.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// Shows lines of `level` and above; `FARM_LOG` overrides it, with filters such as `debug` or `farm_worker=debug`.
pub fn init(level: &str) {
    let filter = EnvFilter::builder()
        .with_default_directive(level.parse().unwrap_or_default())
        .with_env_var("FARM_LOG")
        .from_env_lossy();
    let colours = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(colours)
        .with_target(false);
    // A second call, as in tests, changes nothing.
    let _ = log.try_init();
}
