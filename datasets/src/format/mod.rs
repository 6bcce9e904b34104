//! Bytes to values and back, one file per format.
//!
//! Readers take bytes or text, writers give text or fill a `Write`; paths live in [`crate::layout`]. Every
//! reader answers bad input with one [`crate::FormatError`]. What a header promises is never allocated before the
//! bytes are there; images, whose bytes are compressed, and instances of glTF meshes take more than their files, within
//! bounds that are stated there.

pub mod cam;
pub mod colmap;
pub mod crop;
pub mod gltf;
pub mod image;
pub mod jpeg;
pub mod log;
pub mod mtl;
pub mod npy;
pub mod obj;
pub mod pair;
pub mod pfm;
pub mod ply;
mod polygon;
mod text;
pub mod transform;
pub mod transforms;
