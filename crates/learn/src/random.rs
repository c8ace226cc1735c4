//! Numbers that look random and are the same in every program, made of a seed or of what they are about.

/// By which `SplitMix64` steps from one state to the next.
pub(crate) const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// The bits of a state, mixed (finaliser of `SplitMix64`; G. L. Steele, D. Lea, C. H. Flood, OOPSLA 2014).
pub(crate) const fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
