#![no_main]
//! MTL materials.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::mtl::read_mtl(bytes);
});
