//! From valid inputs and a seed to an input that is mostly not.

/// Numbers where bugs are, in the sizes in which they are written.
const NASTY: [u64; 12] = [
    0,
    1,
    2,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    0xffff_ffff_ffff_ffff,
];

/// The same in texts.
const NASTY_TEXT: [&str; 14] = [
    "-1",
    "0",
    "1",
    "3",
    "255",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "1e300",
    "-0.5",
    "null",
    "[]",
    "\"x\"",
];

/// SplitMix64 (Steele, Lea, Flood 2014).
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.roll() % end.max(1) as u64) as usize
    }

    /// Mostly near the beginning, where headers are.
    fn place(&mut self, end: usize) -> usize {
        match self.below(3) {
            0 => self.below(end),
            1 => self.below(end.min(256)),
            _ => self.below(end.min(2048)),
        }
    }
}

/// The input that belongs to `seed`.
pub(super) fn input(corpus: &[Vec<u8>], seed: u64) -> Vec<u8> {
    let mut dice = Dice(seed);
    let mut bytes = corpus[dice.below(corpus.len())].clone();
    for _ in 0..=dice.below(4) {
        change(&mut bytes, corpus, &mut dice);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, corpus: &[Vec<u8>], dice: &mut Dice) {
    let at = dice.place(bytes.len());
    let end = (at + 1 + dice.below(64)).min(bytes.len());
    match dice.below(10) {
        0 => bytes.truncate(at),
        1 => drop(bytes.drain(at..end)),
        2 => {
            let again = bytes[at.min(bytes.len())..end].to_vec();
            bytes.splice(at.min(bytes.len())..at.min(bytes.len()), again);
        }
        3 => {
            // The rest of another valid input.
            let other = &corpus[dice.below(corpus.len())];
            bytes.truncate(at);
            bytes.extend_from_slice(&other[dice.place(other.len()).min(other.len())..]);
        }
        4 | 5 => number(bytes, at, dice),
        6 => text_number(bytes, at, dice),
        7 => bytes.iter_mut().skip(at).take(end - at.min(end)).for_each(|byte| *byte = dice.roll() as u8),
        _ => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << dice.below(8);
            }
        }
    }
}

/// Overwrites a number of 1, 2, 4 or 8 bytes, of either byte order.
fn number(bytes: &mut [u8], at: usize, dice: &mut Dice) {
    let size = 1 << dice.below(4);
    let value = NASTY[dice.below(NASTY.len())];
    let (little, big) = (value.to_le_bytes(), value.to_be_bytes());
    let value = if dice.below(2) == 0 { &little[..size] } else { &big[8 - size..] };
    if let Some(place) = bytes.get_mut(at..at + size) {
        place.copy_from_slice(value);
    }
}

/// Replaces the next number of a text.
fn text_number(bytes: &mut Vec<u8>, at: usize, dice: &mut Dice) {
    let is_number = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-');
    let Some(start) = bytes.iter().skip(at).position(u8::is_ascii_digit).map(|offset| at + offset) else {
        return;
    };
    let length = bytes[start..].iter().take_while(|byte| is_number(byte)).count();
    bytes.splice(start..start + length, NASTY_TEXT[dice.below(NASTY_TEXT.len())].bytes());
}
