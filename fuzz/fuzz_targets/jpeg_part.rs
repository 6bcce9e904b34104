#![no_main]
//! Parts of JPEGs, beside the whole and beside the crate that reads all of them. The first four bytes say
//! which part, as fractions of the image's sides.

use image::ImageFormat;
use mvs_datasets::format::image::{read_color, read_color_part};
use mvs_datasets::scene::Window;

/// Pixels from and to, of which there is at least one.
fn between([from, to]: [u8; 2], side: u32) -> std::ops::Range<u32> {
    let at = |part: u8| (u64::from(part) * u64::from(side) / 256) as u32;
    at(from.min(to))..at(from.max(to)) + 1
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some(([left, right, top, bottom], bytes)) = bytes.split_first_chunk() else {
        return;
    };
    if !bytes.starts_with(&[0xff, 0xd8]) {
        return; // a PNG
    }
    let window = |(width, height)| Window {
        columns: between([*left, *right], width),
        rows: between([*top, *bottom], height),
    };
    let part = read_color_part(bytes, window);
    let Ok(whole) = read_color(bytes) else {
        assert!(part.is_err(), "a part of what is no whole");
        return;
    };
    let expected = whole.cut(&window(whole.size())).expect("it is inside");
    assert!(part.expect("it is whole") == (whole.size(), expected));
    let other = image::load_from_memory_with_format(bytes, ImageFormat::Jpeg);
    let other = other.expect("the crate reads what we read").into_rgb8();
    assert!(other.dimensions() == whole.size() && other.as_raw() == whole.values().as_flattened());
});
