//! The vocabulary: what a multi-view-stereo scene is made of, in memory.
//!
//! Conventions, converted once at the boundary (see [`crate::layout`]):
//! - Continuous image coordinates: (0, 0) is the outer corner of the top-left pixel, the centre of
//!   pixel (column, row) is (column + 0.5, row + 0.5). Resizing an image is then exact scaling.
//! - Camera frame: OpenCV axes, +X right, +Y down, +Z forward. Poses are `cam_from_world`.
//! - Depth is z-depth along +Z in world units, f32; 0 means none.
//! - World coordinates are f64.

mod aabb;
mod camera;
mod cloud;
mod depth;
mod distortion;
mod mesh;
mod raster;
mod similarity;
pub mod srgb;
mod undistort;
mod view;
mod volume;

pub use aabb::Aabb;
pub use camera::{Camera, Pose};
pub use cloud::PointCloud;
pub use depth::{DepthMap, RejectedDepths};
pub use distortion::Distortion;
pub(crate) use mesh::are_finite;
pub use mesh::{Corner, Cutout, Material, Mesh, MeshColumns};
pub use raster::{ColorImage, Mask, NormalMap, Raster, Window};
pub use similarity::Similarity;
pub use view::{DepthRange, Scene, SourceScore, View};
pub use volume::{Axis, CropVolume};
