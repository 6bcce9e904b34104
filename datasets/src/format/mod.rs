//! Bytes to values and back, one file per format.
//!
//! Readers take bytes or a `Read`, writers a `Write`; paths live in [`crate::layout`]. Every
//! reader answers bad input with one [`crate::FormatError`] and never allocates more than a small
//! multiple of the bytes that are really there.

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
