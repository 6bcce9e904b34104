//! Colours as the decoder has them that reads our images.

/// A value of halved chroma between two: three parts of the nearer to one of the other.
#[inline(always)]
pub(super) fn mix(near: u16, far: u16) -> u16 {
    (3 * near + far + 2) >> 2
}

/// Red, green and blue before they are clipped to 0 … 255, by integers with 14 bits of fraction.
#[inline(always)]
pub(super) fn levels(luma: u8, [blue, red]: [u8; 2]) -> [i32; 3] {
    let (blue, red) = (i32::from(blue) - 128, i32::from(red) - 128);
    let luma = (i32::from(luma) << 14) + (1 << 13) - 1;
    [
        (luma + 22970 * red) >> 14,
        (luma - 11700 * red - 5638 * blue) >> 14,
        (luma + 29032 * blue) >> 14,
    ]
}
