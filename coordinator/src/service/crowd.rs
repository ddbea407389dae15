//! How many may knock at once, and how often. Reads no clock.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// Connections that are open at a time; a worker has one.
pub const CONNECTIONS_MAX: usize = 8192;

/// Connections from strangers, or in their handshake, at a time.
pub const STRANGERS_MAX: usize = 256;

/// The same from one address: the workers of a large host, or of several behind one router, that come back at once.
pub const STRANGERS_PER_ADDRESS_MAX: usize = 64;

/// Connections from one address that are accepted in one go.
const BURST: f64 = 128.0;

/// And then per second.
const PER_SECOND: f64 = 16.0;

/// Addresses that are remembered.
const ADDRESSES_MAX: usize = 4096;

/// Why a connection is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Turned {
    /// From one address.
    #[error("too many connections in a short time")]
    Hurried,
    /// From one address.
    #[error("too many connections that have not shown a certificate")]
    AddressFull,
    /// From anywhere.
    #[error("too many strangers at once")]
    Full,
}

#[derive(Clone, Copy)]
struct Caller {
    strangers: usize,
    allowance: f64,
    refilled: Instant,
}

/// Everybody who has no certificate yet.
#[derive(Default)]
pub struct Crowd {
    callers: BTreeMap<IpAddr, Caller>,
    strangers: usize,
}

impl Crowd {
    /// A connection from `address`; it counts until [`Crowd::leave`].
    pub fn enter(&mut self, address: IpAddr, now: Instant) -> Result<(), Turned> {
        if self.strangers >= STRANGERS_MAX {
            return Err(Turned::Full);
        }
        if self.callers.len() >= ADDRESSES_MAX {
            self.callers.retain(|_, caller| caller.strangers > 0 || caller.allowance_at(now) < BURST);
        }
        if self.callers.len() >= ADDRESSES_MAX && !self.callers.contains_key(&address) {
            return Err(Turned::Full);
        }
        let fresh = Caller { strangers: 0, allowance: BURST, refilled: now };
        let caller = self.callers.entry(address).or_insert(fresh);
        let allowance = caller.allowance_at(now);
        if allowance < 1.0 {
            return Err(Turned::Hurried);
        }
        if caller.strangers >= STRANGERS_PER_ADDRESS_MAX {
            return Err(Turned::AddressFull);
        }
        *caller = Caller { strangers: caller.strangers + 1, allowance: allowance - 1.0, refilled: now };
        self.strangers += 1;
        Ok(())
    }

    /// It is gone, or known by now.
    pub fn leave(&mut self, address: IpAddr) {
        if let Some(caller) = self.callers.get_mut(&address) {
            caller.strangers = caller.strangers.saturating_sub(1);
            self.strangers = self.strangers.saturating_sub(1);
        }
    }
}

impl Caller {
    fn allowance_at(&self, now: Instant) -> f64 {
        let passed: Duration = now.saturating_duration_since(self.refilled);
        (self.allowance + passed.as_secs_f64() * PER_SECOND).min(BURST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u32) -> IpAddr {
        IpAddr::from([10, 0, (last >> 8) as u8, last as u8])
    }

    #[test]
    fn one_address_cannot_take_all_places() {
        let (mut crowd, now) = (Crowd::default(), Instant::now());
        for _ in 0..STRANGERS_PER_ADDRESS_MAX {
            crowd.enter(address(1), now).unwrap();
        }
        assert_eq!(crowd.enter(address(1), now), Err(Turned::AddressFull));
        crowd.enter(address(2), now).unwrap();
        crowd.leave(address(1));
        crowd.enter(address(1), now).unwrap();
    }

    #[test]
    fn many_addresses_cannot_either() {
        let (mut crowd, now) = (Crowd::default(), Instant::now());
        for last in 0..STRANGERS_MAX as u32 {
            crowd.enter(address(last), now).unwrap();
        }
        assert_eq!(crowd.enter(address(5000), now), Err(Turned::Full));
    }

    #[test]
    fn whoever_hurries_waits() {
        let (mut crowd, now) = (Crowd::default(), Instant::now());
        let mut knock = |at| {
            let entered = crowd.enter(address(1), at);
            entered.map(|()| crowd.leave(address(1)))
        };
        let accepted = (0..1000).filter(|_| knock(now).is_ok()).count();
        assert_eq!(accepted, BURST as usize);
        assert_eq!(knock(now), Err(Turned::Hurried));
        let later = now + Duration::from_secs(1);
        assert_eq!((0..1000).filter(|_| knock(later).is_ok()).count(), PER_SECOND as usize);
    }

    #[test]
    fn addresses_are_forgotten_in_time() {
        let (mut crowd, now) = (Crowd::default(), Instant::now());
        for last in 0..3 * ADDRESSES_MAX as u32 {
            let at = now + Duration::from_secs(u64::from(last / 64));
            crowd.enter(address(last), at).unwrap();
            crowd.leave(address(last));
        }
        assert!(crowd.callers.len() <= ADDRESSES_MAX);
    }
}
