//! The same search compiled for processors with AVX2, chosen while running. Same bits: AVX2 widens
//! the operations and changes none; fused multiply-add is not enabled.
#![allow(
    unsafe_code,
    reason = "a function for a newer processor may only be called after asking for it"
)]

use super::blocks::{Block, BlockIndex, LANES};

/// As [`super::search::search`]; `None` where the processor has no AVX2.
#[cfg(target_arch = "x86_64")]
pub(super) fn search(
    index: &BlockIndex,
    queries: &Block,
    bounds: [f64; LANES],
) -> Option<[f64; LANES]> {
    std::arch::is_x86_feature_detected!("avx2")
        // SAFETY: the processor has AVX2, as it just said.
        .then(|| unsafe { x86::search(index, queries, bounds) })
}

/// Other processors have no AVX2.
#[cfg(not(target_arch = "x86_64"))]
pub(super) fn search(_: &BlockIndex, _: &Block, _: [f64; LANES]) -> Option<[f64; LANES]> {
    None
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::super::blocks::{Block, BlockIndex, LANES};
    use super::super::search::{COLUMNS, lower, search_with};
    use glam::DVec3;

    #[target_feature(enable = "avx2")]
    pub(super) fn search(
        index: &BlockIndex,
        queries: &Block,
        bounds: [f64; LANES],
    ) -> [f64; LANES] {
        search_with(index, queries, bounds, |block, query, columns| {
            lower_avx2(block, query, columns);
        })
    }

    #[inline(never)]
    #[target_feature(enable = "avx2")]
    fn lower_avx2(block: &Block, query: DVec3, columns: &mut [f64; COLUMNS]) {
        lower(block, query, columns);
    }
}
