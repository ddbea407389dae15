//! Two hosts with a bad line between them: network namespaces, whose packets pass through this process, where they are delayed
//! and lost. The same as `tc netem`, which not every kernel has.

use crate::harness::wrapped;
use rustix::ioctl::{Setter, ioctl};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

/// Where each host is.
pub const ADDRESSES: [&str; 2] = ["10.77.0.1", "10.77.0.2"];

/// Of the device at each end.
const NAME: &str = "line";

/// A line, while this is there.
pub struct Line {
    hosts: [String; 2],
    is_cut: Arc<AtomicBool>,
}

/// What a packet meets on its way.
#[derive(Clone, Copy)]
pub struct Weather {
    /// In each direction.
    pub delay: Duration,
    /// One of so many packets is lost.
    pub lost_of: u32,
}

impl Line {
    /// None where network namespaces or tunnels are not permitted.
    pub fn lay(weather: Weather) -> Option<Self> {
        let hosts = ["a", "b"].map(|end| format!("tessera-{}-{end}", std::process::id()));
        let line = Self { hosts, is_cut: Arc::default() };
        let ends = [line.end(0)?, line.end(1)?].map(Arc::new);
        for (from, to) in [(0, 1), (1, 0)] {
            carry(ends[from].clone(), ends[to].clone(), weather, line.is_cut.clone());
        }
        Some(line)
    }

    /// A host with its end of the line.
    fn end(&self, host: usize) -> Option<File> {
        let name = &self.hosts[host];
        ip(&["netns", "add", name])?;
        let namespace = File::open(format!("/run/netns/{name}")).ok()?;
        let device = std::thread::spawn(move || {
            // Of this thread only, which ends with this.
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network)).ok()?;
            tunnel()
        });
        let device = device.join().ok()??;
        ip(&["-n", name, "link", "set", "lo", "up"])?;
        ip(&["-n", name, "address", "add", &format!("{}/24", ADDRESSES[host]), "dev", NAME])?;
        ip(&["-n", name, "link", "set", NAME, "up"])?;
        Some(device)
    }

    /// The command, on a host.
    pub fn on(&self, host: usize, command: &Command) -> Command {
        let mut wrapper = Command::new("ip");
        wrapper.args(["netns", "exec", &self.hosts[host]]);
        wrapped(wrapper, command)
    }

    /// Whether nothing comes through any more; neither side is told.
    pub fn cut(&self, is_cut: bool) {
        self.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        for host in &self.hosts {
            ip(&["netns", "delete", host]);
        }
    }
}

/// What the kernel is asked for a tunnel with: `struct ifreq`.
#[repr(C)]
struct TunnelRequest {
    name: [u8; 16],
    flags: u16,
    rest: [u8; 22],
}

/// A device in the namespace of this thread whose packets are read and written here.
fn tunnel() -> Option<File> {
    const SET_INTERFACE: u32 = 0x4004_54ca;
    const PLAIN_PACKETS: u16 = 0x1001;
    let device = File::options().read(true).write(true).open("/dev/net/tun").ok()?;
    let mut request = TunnelRequest { name: [0; 16], flags: PLAIN_PACKETS, rest: [0; 22] };
    request.name[..NAME.len()].copy_from_slice(NAME.as_bytes());
    // SAFETY: TUNSETIFF reads and writes one ifreq, which this is in size and layout.
    unsafe { ioctl(&device, Setter::<SET_INTERFACE, TunnelRequest>::new(request)).ok()? };
    Some(device)
}

fn ip(arguments: &[&str]) -> Option<()> {
    let done = Command::new("ip").args(arguments).output();
    done.is_ok_and(|output| output.status.success()).then_some(())
}

/// Carries packets one way until their host is gone.
fn carry(from: Arc<File>, to: Arc<File>, weather: Weather, is_cut: Arc<AtomicBool>) {
    let (under_way, arriving) = mpsc::channel::<(Instant, Vec<u8>)>();
    std::thread::spawn(move || {
        let (mut packet, mut seed) = (vec![0; 65536], 1u64);
        while let Ok(bytes) = (&*from).read(&mut packet) {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let is_lost = (seed >> 33) % u64::from(weather.lost_of) == 0;
            if is_lost || is_cut.load(Ordering::Relaxed) {
                continue;
            }
            if under_way.send((Instant::now() + weather.delay, packet[..bytes].to_vec())).is_err() {
                return;
            }
        }
    });
    std::thread::spawn(move || {
        for (due, packet) in arriving {
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            // A host that is gone takes nothing.
            let _ = (&*to).write(&packet);
        }
    });
}
