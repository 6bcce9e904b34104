#![no_main]
//! JPEG and PNG.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::image::read_color(bytes);
});
