#![no_main]
//! OBJ meshes.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::obj::read_obj(bytes);
});
