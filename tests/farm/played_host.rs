//! A host that says how busy it is in a `/proc/stat` of its own, so that a story does not hang on who else uses this one.

use crate::harness::{Place, wrapped};
use std::fs::File;
use std::io::{Seek, Write};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// The host, while this is there.
pub struct PlayedHost {
    stat: PathBuf,
    busy: Arc<AtomicU64>,
    gone: Arc<AtomicBool>,
}

impl PlayedHost {
    /// None where a mount of one's own is not permitted.
    pub fn start(place: &Place) -> Option<Self> {
        let (busy, gone) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let host = Self { stat: place.path("stat"), busy: busy.clone(), gone: gone.clone() };
        let mut file = File::create(&host.stat).unwrap();
        let mut hundredths = 0;
        let mut tell = move |busy: u64| {
            hundredths += busy * 10;
            file.rewind().unwrap();
            file.write_all(format!("cpu {hundredths:020} 0 0 0 0 0 0 0 0 0\n").as_bytes()).unwrap();
        };
        tell(0);
        std::thread::spawn(move || {
            while !gone.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(100));
                tell(busy.load(Ordering::Relaxed));
            }
        });
        let works = host.on(&Command::new("true")).output();
        works.is_ok_and(|output| output.status.success()).then_some(host)
    }

    /// From now on others keep so many processors busy.
    pub fn keep_busy(&self, processors: u64) {
        self.busy.store(processors, Ordering::Relaxed);
    }

    /// The command, on this host.
    pub fn on(&self, command: &Command) -> Command {
        let mut wrapper = Command::new("unshare");
        wrapper
            .args(["--mount", "sh", "-c", "mount --bind \"$0\" /proc/stat && exec \"$@\""])
            .arg(&self.stat);
        wrapped(wrapper, command)
    }
}

impl Drop for PlayedHost {
    fn drop(&mut self) {
        self.gone.store(true, Ordering::Relaxed);
    }
}
