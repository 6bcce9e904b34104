//! What a scene's content follows from, as hashes: a view is finished when a view of the same hash
//! was, not when its files merely exist.

use super::{Extra, GenerateOptions, Photographs};
use crate::error::{Error, Result};
use mvs_datasets::scene::{Mesh, View};
use serde::Serialize;

/// Changes when the same inputs would no longer give the same files.
/// Held by a test with hashes of a view's files.
pub(super) const PROCEDURE: &str = "generate 3";

/// A hash of a mesh's content, textures included.
pub fn mesh_digest(mesh: &Mesh) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut bytes = Vec::new();
    // Textures are large: they are not copied.
    let mut feed = |bytes: &mut Vec<u8>, more: &[u8]| {
        let count = (bytes.len() + more.len()) as u64;
        hasher.update(&count.to_le_bytes());
        hasher.update(bytes).update(more);
        bytes.clear();
    };
    for block in mesh.vertices().chunks(1 << 16) {
        let numbers = block.iter().flat_map(|vertex| vertex.to_array());
        bytes.extend(numbers.flat_map(f64::to_le_bytes));
        feed(&mut bytes, &[]);
    }
    for block in mesh.triangles().chunks(1 << 16) {
        bytes.extend(block.iter().flatten().flat_map(|index| index.to_le_bytes()));
        feed(&mut bytes, &[]);
    }
    for block in mesh.texture_coords().unwrap_or_default().chunks(1 << 16) {
        let numbers = block.iter().flatten().flat_map(|uv| uv.to_array());
        bytes.extend(numbers.flat_map(f32::to_le_bytes));
        feed(&mut bytes, &[]);
    }
    bytes.extend(mesh.vertex_colors().unwrap_or_default().iter().flatten());
    feed(&mut bytes, &[]);
    let materials = mesh.triangle_materials().unwrap_or_default();
    bytes.extend(materials.iter().flat_map(|index| index.to_le_bytes()));
    feed(&mut bytes, &[]);
    for material in mesh.materials() {
        bytes.extend(material.color);
        bytes.extend([u8::from(material.tinted), u8::from(material.double_sided)]);
        if let Some(cutout) = &material.cutout {
            bytes.extend(cutout.cutoff.to_le_bytes());
            bytes.extend(cutout.opacity.width().to_le_bytes());
            bytes.extend_from_slice(cutout.opacity.values());
        }
        let mut texels = &[][..];
        if let Some(texture) = &material.texture {
            bytes.extend(texture.width().to_le_bytes());
            texels = texture.values().as_flattened();
        }
        feed(&mut bytes, texels);
    }
    hasher.finalize().to_hex().to_string()
}

/// A hash of a serialised value.
pub(super) fn digest_of(value: &impl Serialize) -> Result<String> {
    let text =
        serde_json::to_vec(value).map_err(|error| Error::invalid("plan", error.to_string()))?;
    Ok(blake3::hash(&text).to_hex().to_string())
}

/// What all views of a scene have in common.
pub(super) fn scene_digest(mesh: &str, options: &GenerateOptions) -> Result<String> {
    // What belongs to the scene as a whole does not change its views.
    let mut options = options.clone();
    for extra in [Extra::Covisibility, Extra::Transforms, Extra::Colmap] {
        options.extras.remove(&extra);
    }
    digest_of(&(PROCEDURE, crate::provenance::VERSION, mesh, options))
}

/// A view's camera and pose, to the last bit.
pub(super) fn view_numbers(view: &View) -> (u32, String, Vec<f64>, String) {
    let camera = &view.camera;
    let mut numbers = vec![f64::from(camera.width()), f64::from(camera.height())];
    numbers.extend(camera.focal().to_array());
    numbers.extend(camera.center().to_array());
    numbers.extend(view.pose.matrix().to_cols_array());
    // `Debug` writes numbers so that they read back to the same bits.
    let lens = format!("{:?}", camera.distortion());
    (view.id, view.name.clone(), numbers, lens)
}

/// What the content of one view follows from: the scene's digest, the view (as given and fitted),
/// the photograph and the views whose sight of it is recorded with it.
pub(super) fn view_digest(
    scene: &str,
    (view, fitted): (&View, &View),
    photographs: &dyn Photographs,
    others: &[View],
) -> Result<String> {
    let others: Vec<_> = others.iter().map(view_numbers).collect();
    let photograph = photographs.digest(view)?;
    digest_of(&(
        scene,
        view_numbers(view),
        view_numbers(fitted),
        photograph,
        others,
    ))
}

/// A scene's folder name: the first 24 hexadecimal digits of a hash of its name.
pub fn scene_id(name: &str) -> String {
    blake3::hash(name.as_bytes()).to_hex()[..24].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Source, generate};
    use crate::progress::Silent;
    use crate::render::Rendering;
    use crate::warning::Warnings;
    use glam::DVec3;
    use mvs_datasets::layout::blended::{BlendedFolder, is_scene_id};
    use mvs_datasets::layout::files;
    use mvs_datasets::scene::{ColorImage, Raster};
    use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
    use std::io::Write;

    fn mesh() -> Mesh {
        Mesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap()
    }

    #[test]
    fn any_change_of_the_mesh_shows() {
        let moved = Mesh::new(
            vec![DVec3::ZERO, DVec3::X, DVec3::Y * (1.0 + f64::EPSILON)],
            vec![[0, 1, 2]],
        );
        let colored = mesh().with_vertex_colors(vec![[0; 3], [0; 3], [0, 0, 1]]);
        let variants = [mesh(), moved.unwrap(), colored.unwrap()].map(|m| mesh_digest(&m));
        assert_eq!(variants[0], mesh_digest(&mesh()));
        assert!(variants[0] != variants[1] && variants[0] != variants[2]);
        assert_ne!(variants[1], variants[2]);
    }

    /// Grey light; the photographs' content is the view's id.
    struct Grey;

    impl Photographs for Grey {
        fn photograph(&self, view: &View, _: &Rendering) -> Result<ColorImage> {
            let (width, height) = (view.camera.width(), view.camera.height());
            let level = |i: u32| [(i % width * 2) as u8, (i / width * 2) as u8, 90];
            Ok(Raster::from_values(
                width,
                height,
                (0..width * height).map(level).collect(),
            )?)
        }

        fn digest(&self, _: &View) -> Result<String> {
            Ok(String::new())
        }
    }

    /// What the files of a view were when [`PROCEDURE`] was written. Other bytes need another
    /// procedure, or finished views of older programs are kept among new ones.
    #[test]
    fn the_procedure_changes_when_the_bytes_do() {
        let folder = tempfile::tempdir().unwrap();
        let options = SyntheticOptions {
            views: 6,
            width: 96,
            height: 72,
            ..SyntheticOptions::default()
        };
        let scene = SyntheticScene::new(options).unwrap();
        let source = Source {
            name: "golden",
            id: &scene_id("golden"),
            mesh: scene.mesh(),
            views: scene.scene().views(),
            photographs: &Grey,
            notes: &[],
            sources: None,
        };
        let options = GenerateOptions {
            extras: [Extra::RenderedImages, Extra::Normals, Extra::Masks].into(),
            ..GenerateOptions::default()
        };
        let target = BlendedFolder::new(folder.path());
        let made = generate(&source, &target, &options, &Silent, &Warnings::default()).unwrap();
        let files = made.views[0].files.iter();
        let found = files.map(|(name, hash)| format!("{name},{hash}\n"));
        let found = format!("procedure,{PROCEDURE}\n{}", found.collect::<String>());
        let golden = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/tests/golden/generated_view.csv"
        );
        if std::env::var_os("MVS_EVAL_UPDATE_GOLDENS").is_some() {
            let path = std::path::Path::new(golden);
            return files::write_atomically(path, |out| out.write_all(found.as_bytes())).unwrap();
        }
        let golden = std::fs::read_to_string(golden).unwrap();
        assert_eq!(
            found, golden,
            "other bytes than in tests/golden/generated_view.csv: change PROCEDURE, then write that file \
             (CONTRIBUTING.md)"
        );
    }

    #[test]
    fn ids_are_24_hexadecimal_digits_of_the_name() {
        assert!(is_scene_id(&scene_id("saharov")));
        assert_ne!(scene_id("a"), scene_id("b"));
        assert!(!is_scene_id("saharov") && !is_scene_id(&"A".repeat(24)));
    }
}
