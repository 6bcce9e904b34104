#![no_main]
//! Two-dimensional f32 arrays of numpy.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::npy::read_f32(bytes);
});
