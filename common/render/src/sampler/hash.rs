//! Mixing of addresses into seeds.

/// 2^64 / golden ratio, odd.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// A bijection of 64-bit words in which every input bit moves every output bit (Stafford 2011, "Better Bit Mixing", variant
/// 13, after an offset that keeps 0 from staying 0).
pub fn mix(word: u64) -> u64 {
    let mut word = word.wrapping_add(GOLDEN);
    word = (word ^ word >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    word = (word ^ word >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ word >> 31
}

/// Spreads a small number over all 64 bits.
pub fn spread(number: u32) -> u64 {
    u64::from(number).wrapping_mul(GOLDEN)
}

/// Four words from one well-mixed word.
pub fn four(word: u64) -> [u32; 4] {
    let (a, b) = (mix(word ^ 0x6a09_e667_f3bc_c908), mix(word ^ 0xbb67_ae85_84ca_a73b));
    [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_input_bit_moves_half_of_the_output_bits() {
        for bit in 0..64 {
            let flipped: u32 =
                (0..4096_u64).map(|i| (mix(mix(i)) ^ mix(mix(i) ^ 1 << bit)).count_ones()).sum();
            let mean = f64::from(flipped) / 4096.0;
            assert!((mean - 32.0).abs() < 0.5, "input bit {bit} moves {mean} bits");
        }
    }
}
