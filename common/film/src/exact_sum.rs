//! A sum of floats that does not depend on the order of its parts.

use serde::{Deserialize, Serialize};

/// Bits of a value that are kept: those of a 32-bit float.
const MANTISSA_BITS: u32 = 24;

/// The lowest bit of the sum stands for `2^LOWEST`.
const LOWEST: i32 = -320;

/// Values from here on are refused: `2^HIGHEST`, the fourth power of what no 32-bit float reaches.
const HIGHEST: i32 = 516;

/// 836 bits for values, and 60 for as many of them as there can be.
const LIMBS: usize = 14;

/// A fixed-point number of the whole range that values of a picture have. Each value is cut to 24 bits, below 2^-320 to nothing, and
/// from then on every addition is exact: so the sum over a frame is the same however the frame was divided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "Written", try_from = "Written")]
pub struct ExactSum {
    /// Lowest first.
    limbs: [u64; LIMBS],
}

impl ExactSum {
    /// Adds a value. False, and nothing is added, if it is negative, not finite or above the range.
    #[must_use]
    pub fn add(&mut self, value: f64) -> bool {
        let bits = value.to_bits();
        let exponent = (bits >> 52) as i32 - 1023;
        if value.is_nan() || exponent >= HIGHEST {
            return value == 0.0;
        }
        // Subnormal numbers lie far below the range.
        let mantissa = ((1 << 52) | (bits & ((1 << 52) - 1))) >> (53 - MANTISSA_BITS);
        let lowest = exponent - (MANTISSA_BITS as i32 - 1) - LOWEST;
        if lowest < 0 {
            return true;
        }
        let placed = u128::from(mantissa) << (lowest % 64);
        self.add_limbs(lowest as usize / 64, &[placed as u64, (placed >> 64) as u64]);
        true
    }

    /// Adds another sum. What left the range, which takes 2^60 of the largest values, is lost.
    pub fn add_sum(&mut self, other: &Self) {
        self.add_limbs(0, &other.limbs);
    }

    fn add_limbs(&mut self, first: usize, limbs: &[u64]) {
        let mut carry = false;
        for (index, limb) in self.limbs[first..].iter_mut().enumerate() {
            let more = limbs.get(index).copied().unwrap_or(0);
            if index >= limbs.len() && !carry {
                return;
            }
            let (sum, over) = limb.overflowing_add(more);
            let (sum, over_again) = sum.overflowing_add(u64::from(carry));
            (*limb, carry) = (sum, over || over_again);
        }
    }

    /// The nearest float, or next to it.
    pub fn value(&self) -> f64 {
        let weighed = |limb: usize| self.limbs[limb] as f64 * 2f64.powi(64 * limb as i32 + LOWEST);
        (0..LIMBS).rev().map(weighed).sum()
    }
}

/// As it is written down: the first limb that is not zero, and the limbs from there to the last that is not.
#[derive(Serialize, Deserialize)]
struct Written(usize, Vec<u64>);

impl From<ExactSum> for Written {
    fn from(sum: ExactSum) -> Self {
        let first = sum.limbs.iter().position(|limb| *limb > 0).unwrap_or(0);
        let end = sum.limbs.iter().rposition(|limb| *limb > 0).map_or(first, |last| last + 1);
        Self(first, sum.limbs[first..end].to_vec())
    }
}

impl TryFrom<Written> for ExactSum {
    type Error = String;

    fn try_from(Written(first, limbs): Written) -> Result<Self, String> {
        let mut sum = Self::default();
        let end = first.saturating_add(limbs.len());
        let place = sum.limbs.get_mut(first..end);
        place.ok_or(format!("a sum has at most {LIMBS} limbs"))?.copy_from_slice(&limbs);
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sum_of(values: &[f64]) -> ExactSum {
        let mut sum = ExactSum::default();
        assert!(values.iter().all(|value| sum.add(*value)), "{values:?}");
        sum
    }

    proptest! {
        #[test]
        fn order_and_division_do_not_matter(values in prop::collection::vec((0.0f64..1.0, -200i32..200), 0..50), cut in 0usize..50) {
            let values: Vec<_> = values.iter().map(|(value, exponent)| value * f64::from(*exponent).exp2()).collect();
            let mut backwards = values.clone();
            backwards.reverse();
            let (left, right) = values.split_at(cut.min(values.len()));
            let mut joined = sum_of(right);
            joined.add_sum(&sum_of(left));
            prop_assert_eq!(sum_of(&values), joined);
            prop_assert_eq!(sum_of(&backwards), joined);
            let plain: f64 = values.iter().sum();
            prop_assert!((joined.value() - plain).abs() <= 2e-7 * plain, "{} {plain}", joined.value());
            let text = serde_json::to_string(&joined).unwrap();
            prop_assert_eq!(serde_json::from_str::<ExactSum>(&text).unwrap(), joined);
        }
    }

    #[test]
    fn a_carry_runs_through() {
        // Two hundred ones in binary, and one more.
        let mut sum = ExactSum::default();
        (0..200).for_each(|exponent| assert!(sum.add(f64::from(exponent).exp2())));
        assert!(sum.add(1.0));
        assert_eq!(sum.value(), 200f64.exp2());
        assert_eq!(serde_json::to_string(&sum).unwrap(), "[8,[256]]");
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        let mut sum = ExactSum::default();
        for value in [f64::NAN, f64::INFINITY, -1.0, 516f64.exp2(), f64::MAX] {
            assert!(!sum.add(value), "{value}");
        }
        assert!(sum.add(0.0) && sum.add(-0.0) && sum.add(f64::MIN_POSITIVE));
        assert_eq!(sum, ExactSum::default());
        for text in ["[2,[1,1,1,1,1,1,1,1,1,1,1,1,1]]", "[18446744073709551615,[1]]", "[14,[1]]"] {
            assert!(serde_json::from_str::<ExactSum>(text).is_err(), "{text}");
        }
    }
}
