//! Eight numbers at once: AVX2 where the processor has it, plain arrays elsewhere, the same bits from both.
//!
//! Only operations that IEEE 754 rounds exactly are here: no fused multiply-add, no reciprocal estimates. Minimum and
//! maximum follow the x86 rule (the second operand when either is not a number) in both.

/// Eight f32.
pub(super) trait Lanes: Copy {
    fn splat(value: f32) -> Self;
    fn load(values: &[f32; 8]) -> Self;
    fn store(self, values: &mut [f32; 8]);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn abs(self) -> Self;
    /// `other` where either is not a number.
    fn min(self, other: Self) -> Self;
    /// `other` where either is not a number.
    fn max(self, other: Self) -> Self;
    /// Bit i is set where lane i is smaller than the other's.
    fn less(self, other: Self) -> u32;
    /// Bit i is set where lane i is at most the other's.
    fn at_most(self, other: Self) -> u32;
    /// Bit i is set where the lanes are equal.
    fn equal(self, other: Self) -> u32;
}

/// Three numbers, each over all lanes.
#[inline(always)]
pub(super) fn splat3<S: Lanes>([x, y, z]: [f32; 3]) -> [S; 3] {
    [S::splat(x), S::splat(y), S::splat(z)]
}

/// The fallback, and the definition of what [`Avx2`] computes.
#[derive(Clone, Copy)]
pub(super) struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }

    #[inline(always)]
    fn test(self, other: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        (0..8).fold(0, |mask, i| mask | u32::from(f(self.0[i], other.0[i])) << i)
    }
}

impl Lanes for Portable {
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 8])
    }
    #[inline(always)]
    fn load(values: &[f32; 8]) -> Self {
        Self(*values)
    }
    #[inline(always)]
    fn store(self, values: &mut [f32; 8]) {
        *values = self.0;
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.map(f32::abs))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn less(self, other: Self) -> u32 {
        self.test(other, |a, b| a < b)
    }
    #[inline(always)]
    fn at_most(self, other: Self) -> u32 {
        self.test(other, |a, b| a <= b)
    }
    #[inline(always)]
    fn equal(self, other: Self) -> u32 {
        self.test(other, |a, b| a == b)
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::Lanes;

    /// 256-bit registers. Only created below a function that is compiled for AVX2 and reached after the processor was asked.
    #[derive(Clone, Copy)]
    pub(in crate::accel) struct Avx2(__m256);

    /// Wraps one intrinsic that touches registers only.
    macro_rules! register_only {
        ($e:expr) => {
            // SAFETY: every caller runs below `accel::query::avx2`, which is reached only on processors with AVX2.
            unsafe { $e }
        };
    }

    impl Lanes for Avx2 {
        #[inline(always)]
        fn splat(value: f32) -> Self {
            Self(register_only!(_mm256_set1_ps(value)))
        }
        #[inline(always)]
        fn load(values: &[f32; 8]) -> Self {
            // SAFETY: AVX2 as above; the array holds the eight numbers that are read, at any alignment.
            Self(unsafe { _mm256_loadu_ps(values.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, values: &mut [f32; 8]) {
            // SAFETY: AVX2 as above; the array has room for the eight numbers that are written, at any alignment.
            unsafe { _mm256_storeu_ps(values.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(register_only!(_mm256_add_ps(self.0, other.0)))
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(register_only!(_mm256_sub_ps(self.0, other.0)))
        }
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(register_only!(_mm256_mul_ps(self.0, other.0)))
        }
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            Self(register_only!(_mm256_div_ps(self.0, other.0)))
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(register_only!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            Self(register_only!(_mm256_min_ps(self.0, other.0)))
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            Self(register_only!(_mm256_max_ps(self.0, other.0)))
        }
        #[inline(always)]
        fn less(self, other: Self) -> u32 {
            register_only!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0))) as u32
        }
        #[inline(always)]
        fn at_most(self, other: Self) -> u32 {
            register_only!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0))) as u32
        }
        #[inline(always)]
        fn equal(self, other: Self) -> u32 {
            register_only!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, other.0))) as u32
        }
    }
}
