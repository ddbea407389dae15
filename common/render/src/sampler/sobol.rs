//! The first four dimensions of the Sobol sequence (Joe and Kuo 2008, "Constructing Sobol Sequences with Better
//! Two-Dimensional Projections"), with indices and points stored lowest digit first.

/// A primitive polynomial over GF(2) and the direction numbers that start its recurrence.
struct Dimension {
    degree: usize,
    /// Inner coefficients, highest power first.
    coefficients: u32,
    start: &'static [u32],
}

/// The dimensions after the first, which is the radical inverse.
const DIMENSIONS: [Dimension; 3] = [
    Dimension { degree: 1, coefficients: 0, start: &[1] },
    Dimension { degree: 2, coefficients: 1, start: &[1, 3] },
    Dimension { degree: 3, coefficients: 1, start: &[1, 3, 1] },
];

/// For each group of four index bits (as they are stored, reversed) and each value: the sum of their columns. 2 KiB, so that
/// the table stays in the first-level cache beside everything else.
static TABLE: [[[u32; 4]; 16]; 8] = table();

/// The point at an index; both with their digits reversed.
pub fn point_reversed(index_reversed: u32) -> [u32; 4] {
    let mut point = [0; 4];
    let mut group = 0;
    while group < 8 {
        let columns = &TABLE[group][(index_reversed >> (4 * group) & 15) as usize];
        for (digits, column) in point.iter_mut().zip(columns) {
            *digits ^= column;
        }
        group += 1;
    }
    point
}

const fn table() -> [[[u32; 4]; 16]; 8] {
    let columns = columns();
    let mut table = [[[0; 4]; 16]; 8];
    let mut entry = 0;
    while entry < 8 * 16 * 4 {
        let (group, value, dimension) = (entry / 64, entry / 4 % 16, entry % 4);
        let mut bit = 0;
        while bit < 4 {
            if value >> bit & 1 == 1 {
                // Bit b of the reversed index is bit 31-b of the index.
                table[group][value][dimension] ^= columns[dimension][31 - (4 * group + bit)].reverse_bits();
            }
            bit += 1;
        }
        entry += 1;
    }
    table
}

/// Column `i` of a dimension's generator matrix as a 32-bit fraction.
const fn columns() -> [[u32; 32]; 4] {
    let mut columns = [[0; 32]; 4];
    let mut i = 0;
    while i < 32 {
        columns[0][i] = 1 << (31 - i);
        i += 1;
    }
    let mut d = 0;
    while d < DIMENSIONS.len() {
        columns[d + 1] = recurrence(&DIMENSIONS[d]);
        d += 1;
    }
    columns
}

const fn recurrence(dimension: &Dimension) -> [u32; 32] {
    let degree = dimension.degree;
    let mut columns = [0_u32; 32];
    let mut i = 0;
    while i < 32 {
        columns[i] = if i < degree {
            dimension.start[i] << (31 - i)
        } else {
            let mut column = columns[i - degree] ^ columns[i - degree] >> degree;
            let mut k = 1;
            while k < degree {
                if dimension.coefficients >> (degree - 1 - k) & 1 == 1 {
                    column ^= columns[i - k];
                }
                k += 1;
            }
            column
        };
        i += 1;
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_begins_as_published() {
        let point = |index: u32| {
            point_reversed(index.reverse_bits())
                .map(|digits| f64::from(digits.reverse_bits()) / 2_f64.powi(32))
        };
        assert_eq!(point(0), [0.0; 4]);
        assert_eq!(point(1), [0.5; 4]);
        assert_eq!(point(2), [0.25, 0.75, 0.75, 0.75]);
        assert_eq!(point(3), [0.75, 0.25, 0.25, 0.25]);
        assert_eq!(point(4), [0.125, 0.625, 0.375, 0.125]);
    }

    #[test]
    fn every_dimension_is_a_permutation_of_all_fractions() {
        for dimension in 0..4 {
            let mut basis: Vec<u32> = columns()[dimension].to_vec();
            for bit in (0..32).rev() {
                let pivot = basis.iter().position(|c| c >> bit & 1 == 1).expect("independent columns");
                let column = basis.swap_remove(pivot);
                basis.iter_mut().filter(|c| **c >> bit & 1 == 1).for_each(|c| *c ^= column);
            }
        }
    }
}
