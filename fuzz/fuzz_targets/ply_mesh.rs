#![no_main]
//! Vertices and faces of a PLY.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::ply::read_mesh(bytes);
});
