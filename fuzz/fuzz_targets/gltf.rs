#![no_main]
//! glTF and GLB meshes, the files they name refused.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let none = |_: &str| Err("no files here".to_owned());
    let _ = mvs_datasets::format::gltf::read_gltf(bytes, &none);
});
