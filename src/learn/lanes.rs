//! Sixteen `f32` side by side, in the registers of the machine's instruction set.
//!
//! The width is the same everywhere, and with it the order of additions: AVX2 and AVX-512 give
//! identical bits. The portable form rounds products before it adds them.

/// Rows that are computed side by side.
pub(super) const WIDTH: usize = 16;

/// Sixteen values in memory, aligned to a cache line.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Packet(pub [f32; WIDTH]);

impl Packet {
    pub(super) const ZERO: Self = Self([0.0; WIDTH]);

    /// The sum, by pairwise halves.
    #[inline(always)]
    pub(super) fn sum(&self) -> f64 {
        let eight: [f32; 8] = std::array::from_fn(|i| self.0[i] + self.0[i + 8]);
        let four: [f32; 4] = std::array::from_fn(|i| eight[i] + eight[i + 4]);
        f64::from((four[0] + four[2]) + (four[1] + four[3]))
    }
}

/// Sixteen values in registers.
///
/// # Safety
/// Every method may use the instructions of its type; the caller must have detected them on this
/// machine.
pub(super) trait Lanes: Copy {
    unsafe fn splat(value: f32) -> Self;
    unsafe fn load(packet: &Packet) -> Self;
    unsafe fn store(self, packet: &mut Packet);
    unsafe fn plus(self, other: Self) -> Self;
    unsafe fn minus(self, other: Self) -> Self;
    unsafe fn times(self, other: Self) -> Self;
    /// `self + a b`, rounded once if the machine supports it.
    unsafe fn plus_product(self, a: Self, b: Self) -> Self;
    /// `max(self, 0)`; a NaN of either sign may stay or become 0.
    unsafe fn rectified(self) -> Self;
    /// `self` where `rectified` is above 0, else 0.
    unsafe fn where_active(self, rectified: Self) -> Self;
}

/// Without explicit vector instructions; the compiler may still vectorise it.
#[derive(Clone, Copy)]
pub(super) struct Portable([f32; WIDTH]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, operation: impl Fn(f32, f32) -> f32) -> Self {
        let mut result = self;
        for (value, other) in result.0.iter_mut().zip(other.0) {
            *value = operation(*value, other);
        }
        result
    }
}

impl Lanes for Portable {
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; WIDTH])
    }
    #[inline(always)]
    unsafe fn load(packet: &Packet) -> Self {
        Self(packet.0)
    }
    #[inline(always)]
    unsafe fn store(self, packet: &mut Packet) {
        packet.0 = self.0;
    }
    #[inline(always)]
    unsafe fn plus(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    unsafe fn minus(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    unsafe fn times(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    unsafe fn plus_product(self, a: Self, b: Self) -> Self {
        self.zip(a.zip(b, |a, b| a * b), |sum, product| sum + product)
    }
    #[inline(always)]
    unsafe fn rectified(self) -> Self {
        self.zip(self, |value, _| if value > 0.0 { value } else { 0.0 })
    }
    #[inline(always)]
    unsafe fn where_active(self, rectified: Self) -> Self {
        self.zip(rectified, |value, rectified| if rectified > 0.0 { value } else { 0.0 })
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{Lanes, Packet};

    /// Two registers of AVX2, with FMA.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256, __m256);

    // SAFETY of the pointers below: a packet holds sixteen f32 and is aligned to 64 bytes.
    impl Lanes for Avx2 {
        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            unsafe { Self(_mm256_set1_ps(value), _mm256_set1_ps(value)) }
        }
        #[inline(always)]
        unsafe fn load(packet: &Packet) -> Self {
            let first = packet.0.as_ptr();
            unsafe { Self(_mm256_load_ps(first), _mm256_load_ps(first.add(8))) }
        }
        #[inline(always)]
        unsafe fn store(self, packet: &mut Packet) {
            let first = packet.0.as_mut_ptr();
            unsafe {
                _mm256_store_ps(first, self.0);
                _mm256_store_ps(first.add(8), self.1);
            }
        }
        #[inline(always)]
        unsafe fn plus(self, other: Self) -> Self {
            unsafe { Self(_mm256_add_ps(self.0, other.0), _mm256_add_ps(self.1, other.1)) }
        }
        #[inline(always)]
        unsafe fn minus(self, other: Self) -> Self {
            unsafe { Self(_mm256_sub_ps(self.0, other.0), _mm256_sub_ps(self.1, other.1)) }
        }
        #[inline(always)]
        unsafe fn times(self, other: Self) -> Self {
            unsafe { Self(_mm256_mul_ps(self.0, other.0), _mm256_mul_ps(self.1, other.1)) }
        }
        #[inline(always)]
        unsafe fn plus_product(self, a: Self, b: Self) -> Self {
            unsafe { Self(_mm256_fmadd_ps(a.0, b.0, self.0), _mm256_fmadd_ps(a.1, b.1, self.1)) }
        }
        // Positive floats are positive as integers too, and all others are not; integer
        // instructions leave the ports free that the products need.
        #[inline(always)]
        unsafe fn rectified(self) -> Self {
            unsafe {
                let zero = _mm256_setzero_si256();
                let rectify =
                    |x| _mm256_castsi256_ps(_mm256_max_epi32(_mm256_castps_si256(x), zero));
                Self(rectify(self.0), rectify(self.1))
            }
        }
        #[inline(always)]
        unsafe fn where_active(self, rectified: Self) -> Self {
            unsafe {
                let zero = _mm256_setzero_si256();
                let keep = |x, rectified| {
                    let active = _mm256_cmpgt_epi32(_mm256_castps_si256(rectified), zero);
                    _mm256_and_ps(x, _mm256_castsi256_ps(active))
                };
                Self(keep(self.0, rectified.0), keep(self.1, rectified.1))
            }
        }
    }

    /// One register of AVX-512.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx512(__m512);

    impl Lanes for Avx512 {
        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            unsafe { Self(_mm512_set1_ps(value)) }
        }
        #[inline(always)]
        unsafe fn load(packet: &Packet) -> Self {
            unsafe { Self(_mm512_load_ps(packet.0.as_ptr())) }
        }
        #[inline(always)]
        unsafe fn store(self, packet: &mut Packet) {
            unsafe { _mm512_store_ps(packet.0.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        unsafe fn plus(self, other: Self) -> Self {
            unsafe { Self(_mm512_add_ps(self.0, other.0)) }
        }
        #[inline(always)]
        unsafe fn minus(self, other: Self) -> Self {
            unsafe { Self(_mm512_sub_ps(self.0, other.0)) }
        }
        #[inline(always)]
        unsafe fn times(self, other: Self) -> Self {
            unsafe { Self(_mm512_mul_ps(self.0, other.0)) }
        }
        #[inline(always)]
        unsafe fn plus_product(self, a: Self, b: Self) -> Self {
            unsafe { Self(_mm512_fmadd_ps(a.0, b.0, self.0)) }
        }
        #[inline(always)]
        unsafe fn rectified(self) -> Self {
            unsafe {
                let zero = _mm512_setzero_si512();
                Self(_mm512_castsi512_ps(_mm512_max_epi32(_mm512_castps_si512(self.0), zero)))
            }
        }
        #[inline(always)]
        unsafe fn where_active(self, rectified: Self) -> Self {
            unsafe {
                let zero = _mm512_setzero_si512();
                let active = _mm512_cmpgt_epi32_mask(_mm512_castps_si512(rectified.0), zero);
                Self(_mm512_maskz_mov_ps(active, self.0))
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::{Avx2, Avx512};
