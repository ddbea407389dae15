//! How a program ends when it cannot do what it was asked.

use std::process::ExitCode;

/// Why a command did not do what it was asked, in one sentence.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// Bad usage or input: the user has to change something.
    #[error("{0}")]
    Input(String),
    /// All was well asked, but it could not be done.
    #[error("{0}")]
    Failed(String),
}

impl Fault {
    /// Bad usage or input.
    pub fn input(fault: impl ToString) -> Self {
        Self::Input(fault.to_string())
    }

    /// A failure.
    pub fn failed(fault: impl ToString) -> Self {
        Self::Failed(fault.to_string())
    }

    /// Says the sentence on standard error and gives the program's exit code: 2 for bad usage or input, 1 for failure.
    pub fn report(&self) -> ExitCode {
        eprintln!("error: {self}");
        match self {
            Self::Input(_) => ExitCode::from(2),
            Self::Failed(_) => ExitCode::FAILURE,
        }
    }
}
