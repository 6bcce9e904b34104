#![no_main]
//! COLMAP's dense arrays: depth maps and normal maps.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::colmap::dense::read_size(bytes);
    let _ = mvs_datasets::format::colmap::dense::read_gray(bytes);
    let _ = mvs_datasets::format::colmap::dense::read_normals(bytes);
});
