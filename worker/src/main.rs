//! The worker: settings, log, work, exit code.

use clap::Parser;
use farm_worker::settings::Settings;
use std::process::ExitCode;

fn main() -> ExitCode {
    let settings = Settings::parse();
    farm_worker::log::init("info");
    match farm_worker::program::run(settings) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => fault.report(),
    }
}
