//! The coordinator: settings, log, run, exit code.

use clap::Parser;
use farm_coordinator::cli::Settings;
use std::process::ExitCode;

fn main() -> ExitCode {
    let settings = Settings::parse();
    farm_worker::log::init(settings.log_level());
    match settings.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => fault.report(),
    }
}
