//! The random numbers of samples. Every sample of a pixel has its own numbers, computed from the seed, its pixel, its
//! half and its index alone, so that neither threads nor passes change them.

use rand_xoshiro::Xoshiro128PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// How samples are spread over the domain of integration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Sequence {
    /// Independent random numbers.
    Random,
    /// Owen-scrambled Sobol points (Burley 2020), padded in sets of four dimensions, with independent scrambles for
    /// each pixel and half. Less noise; the sample variance then overstates the variance of the mean.
    LowDiscrepancy,
}

/// The random numbers of one sample, in sets of four.
pub(super) enum Numbers {
    Random(Xoshiro128PlusPlus),
    Sobol { index: u32, key: u64 },
}

/// Number of points in the crate's sequence; later points start another scramble.
const SOBOL_POINTS: u32 = 1 << 16;

impl Numbers {
    pub(super) fn new(sequence: Sequence, seed: u64, pixel: usize, half: usize, index: u32) -> Self {
        let place = mix(mix(seed).wrapping_add(2 * pixel as u64 + half as u64));
        match sequence {
            Sequence::Random => Self::Random(Xoshiro128PlusPlus::seed_from_u64(place ^ u64::from(index))),
            Sequence::LowDiscrepancy => Self::Sobol {
                index: index % SOBOL_POINTS,
                key: mix(place.wrapping_add(u64::from(index / SOBOL_POINTS))),
            },
        }
    }

    /// Returns the next four numbers, in [0, 1). Callers take whole sets, so that the dimension of a number does not
    /// depend on numbers that were left over.
    pub(super) fn next_four(&mut self) -> [f32; 4] {
        match self {
            Self::Random(generator) => std::array::from_fn(|_| (generator.next_u32() >> 8) as f32 / (1 << 24) as f32),
            Self::Sobol { index, key } => {
                *key = mix(*key);
                sobol_burley::sample_4d(*index, 0, (*key >> 32) as u32)
            }
        }
    }
}

/// One step of SplitMix64: neighbouring inputs give unrelated outputs.
fn mix(value: u64) -> u64 {
    let z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
