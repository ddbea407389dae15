//! Owen scrambling by hashing: at each binary digit, the digits before it decide whether it is flipped.

/// A fraction whose digits are stored in reverse, the most significant as bit 0, after the part of the scrambling that needs no seed.
///
/// Multiplications and additions carry upwards only, so each bit of the result depends on the bits at or below it, which is
/// what nested scrambling asks for (Laine and Karras 2011; the even multipliers are those of Vegdahl 2021, "Building a Better
/// LK Hash").
#[derive(Clone, Copy, Debug)]
pub struct Digits(u32);

impl Digits {
    /// From digits in reverse.
    pub fn from_reversed(digits: u32) -> Self {
        Self(digits ^ digits.wrapping_mul(0x3d20_adea))
    }

    /// Different for different fractions.
    pub fn bits(self) -> u32 {
        self.0
    }

    /// The scrambled digits, in reverse.
    pub fn scramble(self, seed: u32) -> u32 {
        let mut digits = self.0.wrapping_add(seed);
        digits = digits.wrapping_mul(seed >> 16 | 1);
        digits ^= digits.wrapping_mul(0x0552_6c56);
        digits ^ digits.wrapping_mul(0x53a2_2864)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scramble_reversed(digits: u32, seed: u32) -> u32 {
        Digits::from_reversed(digits).scramble(seed)
    }

    #[test]
    fn a_digit_depends_on_the_digits_before_it_only() {
        for seed in [0, 1, 0x1234_5678, u32::MAX] {
            for bit in 0..32 {
                for digits in [0, 0xdead_beef, u32::MAX, 0x0f0f_1234] {
                    let before = (1_u32 << bit) - 1;
                    let changed =
                        scramble_reversed(digits, seed) ^ scramble_reversed(digits ^ 1 << bit, seed);
                    assert_eq!(changed & before, 0, "bit {bit} moves an earlier one");
                    assert_ne!(changed & 1 << bit, 0, "bit {bit} does not move itself");
                }
            }
        }
    }

    #[test]
    fn every_digit_is_flipped_as_often_as_not() {
        for digits in [0, 0x5555_5555, 0xffff_0000_u32] {
            let mut flips = [0_u32; 32];
            for i in 0..8192 {
                let flipped = scramble_reversed(digits, super::super::hash::mix(i) as u32) ^ digits;
                (0..32).for_each(|bit| flips[bit] += flipped >> bit & 1);
            }
            for (bit, count) in flips.iter().enumerate() {
                let share = f64::from(*count) / 8192.0;
                assert!(
                    (share - 0.5).abs() < 0.03,
                    "digit {bit} of {digits:#x} is flipped with probability {share}"
                );
            }
        }
    }
}
