//! A scene folder of the BlendedMVS kind.
//!
//! ```text
//! ROOT/BlendedMVS_training.txt …              lists of scene ids, one a line
//! ROOT/<id>/blended_images/00000000.jpg       and 00000000_masked.jpg, background 0
//! ROOT/<id>/cams/00000000_cam.txt             and pair.txt
//! ROOT/<id>/rendered_depth_maps/00000000.pfm  z-depth, 0 = none
//! ```
//!
//! Written is the subset that the strictest public readers take: nothing but these files in those
//! three folders. What this program adds stands in folders beside them and in `scene.json`.

pub mod record;

use super::files;
use super::mvsnet::{self, CamsOptions, PixelCentre};
use crate::error::{Error, Result};
use crate::format::image::{self, JpegOptions};
use crate::format::pfm;
use crate::scene::{ColorImage, DepthMap, Mask, NormalMap, RejectedDepths, Scene, View};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The paths of one scene folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlendedFolder {
    path: PathBuf,
}

impl BlendedFolder {
    /// The scene folder at `path`, there or not.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn of_view(&self, folder: &str, id: u32, suffix: &str) -> PathBuf {
        self.path.join(folder).join(mvsnet::file_name(id, suffix))
    }

    /// The blended image of a view.
    pub fn image(&self, id: u32) -> PathBuf {
        self.of_view("blended_images", id, ".jpg")
    }

    /// The blended image with background 0.
    pub fn masked_image(&self, id: u32) -> PathBuf {
        self.of_view("blended_images", id, "_masked.jpg")
    }

    /// The camera of a view.
    pub fn cam(&self, id: u32) -> PathBuf {
        self.of_view("cams", id, "_cam.txt")
    }

    /// The source views of all views.
    pub fn pairs(&self) -> PathBuf {
        self.path.join("cams").join("pair.txt")
    }

    /// The rendered depth of a view.
    pub fn depth(&self, id: u32) -> PathBuf {
        self.of_view("rendered_depth_maps", id, ".pfm")
    }

    /// The photograph of a view, in the render's camera.
    pub fn input_image(&self, id: u32) -> PathBuf {
        self.of_view("input_images", id, ".jpg")
    }

    /// The rendering of a view.
    pub fn rendered_image(&self, id: u32) -> PathBuf {
        self.of_view("rendered_images", id, ".png")
    }

    /// The mask of a view: 255 where there is rendered surface.
    pub fn mask(&self, id: u32) -> PathBuf {
        self.of_view("masks", id, ".png")
    }

    /// The normals of a view, camera frame, facing the camera, 0 = none.
    pub fn normals(&self, id: u32) -> PathBuf {
        self.of_view("normals", id, ".pfm")
    }

    /// Interpolated normals in the camera frame, PFM.
    pub fn interpolated_normals(&self, id: u32) -> PathBuf {
        self.path.join(format!("interpolated_normals/{id:08}.pfm"))
    }

    /// What each pixel shows, PNG.
    pub fn sight(&self, id: u32) -> PathBuf {
        self.path.join(format!("sight/{id:08}.png"))
    }

    /// Where depth jumps: 255 on both sides of a jump.
    pub fn depth_edges(&self, id: u32) -> PathBuf {
        self.of_view("depth_edges", id, ".png")
    }

    /// Where the surface of `reference` is seen by `source`.
    pub fn occlusion(&self, reference: u32, source: u32) -> PathBuf {
        let name = format!("{reference:08}_{source:08}.png");
        self.path.join("occlusion").join(name)
    }

    /// How much of each view's surface each other view sees.
    pub fn covisibility(&self) -> PathBuf {
        self.path.join("covisibility.npy")
    }

    /// The cameras as nerfstudio reads them.
    pub fn transforms(&self) -> PathBuf {
        self.path.join("transforms.json")
    }

    /// The folder of the cameras as a COLMAP text model.
    pub fn colmap(&self) -> PathBuf {
        self.path.join("sparse").join("0")
    }

    /// What the scene is and by which conventions; see [`record::SceneFile`].
    pub fn record(&self) -> PathBuf {
        self.path.join("scene.json")
    }

    /// Reads cameras and source views. The image size is read from the images' headers, the pixel
    /// centre from `scene.json`; without one it is (0.5, 0.5), as the set's authors say, or what
    /// `pixel_centre` says.
    ///
    /// # Errors
    /// As [`mvsnet::read_scene`]; images that cannot be listed or the first of which cannot be read, and, without a
    /// given `pixel_centre`, a `scene.json` that [`record::read`] refuses.
    pub fn read_scene(&self, pixel_centre: Option<PixelCentre>) -> Result<Scene> {
        let recorded = || Ok(record::read(&self.record())?.map(|record| record.pixel_centre));
        let pixel_centre = match pixel_centre {
            Some(given) => given,
            None => recorded()?.unwrap_or_default(),
        };
        let options = CamsOptions {
            pixel_centre,
            size: self.image_size()?,
        };
        mvsnet::read_scene(&self.path.join("cams"), &options)
    }

    /// The (width, height) of the first image by name, if there is any.
    fn image_size(&self) -> Result<Option<(u32, u32)>> {
        let folder = self.path.join("blended_images");
        if !folder.is_dir() {
            return Ok(None);
        }
        let Some(first) = names_in(&folder)?.into_iter().find(|name| is_image(name)) else {
            return Ok(None);
        };
        let path = folder.join(first);
        let bytes = std::fs::read(&path).map_err(Error::io(&path, "read"))?;
        let size = image::read_size(&bytes).map_err(Error::in_file(&path))?;
        Ok(Some(size))
    }

    /// Reads the depth map of a view.
    ///
    /// # Errors
    /// As [`files::read_depth`].
    pub fn read_depth(&self, id: u32) -> Result<(DepthMap, RejectedDepths)> {
        files::read_depth(&self.depth(id))
    }

    /// Reads the blended image of a view.
    ///
    /// # Errors
    /// As [`files::read_image`].
    pub fn read_image(&self, id: u32) -> Result<ColorImage> {
        files::read_image(&self.image(id))
    }

    /// Writes an image as JPEG.
    ///
    /// # Errors
    /// As [`files::write_atomically`], and a side above 65,535 pixels.
    pub fn write_jpeg(path: &Path, image: &ColorImage, options: JpegOptions) -> Result<()> {
        files::write_atomically(path, |out| image::write_jpeg(out, image, options))
    }

    /// Writes an image as PNG.
    ///
    /// # Errors
    /// As [`files::write_atomically`].
    pub fn write_png(path: &Path, image: &ColorImage) -> Result<()> {
        files::write_atomically(path, |out| image::write_png(out, image))
    }

    /// Writes a mask as PNG of 0 and 255.
    ///
    /// # Errors
    /// As [`files::write_atomically`].
    pub fn write_mask(path: &Path, mask: &Mask) -> Result<()> {
        files::write_atomically(path, |out| image::write_mask_png(out, mask))
    }

    /// Writes a view's depth.
    ///
    /// # Errors
    /// As [`files::write_atomically`].
    pub fn write_depth(&self, id: u32, depth: &DepthMap) -> Result<()> {
        files::write_atomically(&self.depth(id), |out| pfm::write_gray(out, depth.raster()))
    }

    /// Writes a view's normals.
    ///
    /// # Errors
    /// As [`files::write_atomically`].
    pub fn write_normals(&self, id: u32, normals: &NormalMap) -> Result<()> {
        files::write_atomically(&self.normals(id), |out| pfm::write_color(out, normals))
    }

    /// Writes a view's camera; the view needs a depth range.
    ///
    /// # Errors
    /// As [`mvsnet::write_view`].
    pub fn write_cam(&self, view: &View, pixel_centre: PixelCentre) -> Result<()> {
        mvsnet::write_view(&self.cam(view.id), view, pixel_centre)
    }
}

/// The 24 hexadecimal digits of a scene's folder; the published set has no others.
pub fn is_scene_id(id: &str) -> bool {
    id.len() == 24 && id.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// The scene folders of `root`, by name: those with a `cams/pair.txt`.
///
/// # Errors
/// As [`names_in`].
pub fn scenes_in(root: &Path) -> Result<Vec<String>> {
    let names = names_in(root)?;
    let is_scene = |name: &String| BlendedFolder::new(root.join(name)).pairs().is_file();
    Ok(names.into_iter().filter(is_scene).collect())
}

/// The list files of a root.
const LISTS: [&str; 6] = [
    "BlendedMVS_list.txt",
    "BlendedMVS_training.txt",
    "BlendedMVG_training.txt",
    "training_list.txt",
    "validation_list.txt",
    "all_list.txt",
];

/// The scenes that the list files of `root` name, by name; none without such files.
///
/// # Errors
/// A list file that is there and that [`files::read_text`] refuses.
pub fn listed_in(root: &Path) -> Result<BTreeSet<String>> {
    let mut listed = BTreeSet::new();
    for path in LISTS.map(|name| root.join(name)) {
        if path.is_file() {
            let text = files::read_text(&path)?;
            let names = text.lines().map(str::trim);
            let names = names.filter(|name| !name.is_empty() && !name.starts_with('#'));
            listed.extend(names.map(str::to_owned));
        }
    }
    Ok(listed)
}

/// What this program leaves in a folder whose making has begun and not ended.
pub const UNFINISHED: &str = "run.partial.toml";

/// Writes the list files for the scenes of `root`, by way of the folder of one of them: the scene
/// `id` is for validation if `held_out`, else for training, and the others are for what the lists
/// say they are. Others that are unfinished are left out. Lines that name no scene of `root` (an official
/// list of a data set that is here in part, comments) are kept, all in their order.
///
/// Waits until no other run holds the lists of `root`. They are held until what is returned is dropped: a scene is
/// to be marked as finished before another run looks, which would leave it out.
///
/// # Errors
/// A `root` that cannot be listed, a list file that is there and that [`files::read_text`] refuses, and what
/// [`files::write_by_way_of`] brings.
pub fn write_lists(root: &Path, id: &str, held_out: bool) -> Result<HeldLists> {
    let held = HeldLists::of(root);
    let unfinished = |scene: &str| scene != id && root.join(scene).join(UNFINISHED).exists();
    let mut all = scenes_in(root)?;
    all.retain(|scene| !unfinished(scene));
    let read = |name: &str| match root.join(name) {
        path if path.is_file() => files::read_text(&path),
        _ => Ok(String::new()),
    };
    let old = read("validation_list.txt")?;
    let validates = |scene: &String| match scene == id {
        true => held_out,
        false => old.lines().any(|line| line.trim() == scene),
    };
    let (validation, training): (Vec<_>, Vec<_>) = all.iter().cloned().partition(validates);
    let of_lists = [&all, &training, &training, &training, &validation, &all];
    for (name, ids) in LISTS.into_iter().zip(of_lists) {
        let ours = |scene: &str| all.iter().any(|here| here == scene) || unfinished(scene);
        let lines = merged(&read(name)?, ids, ours);
        files::write_by_way_of(&root.join(id), &root.join(name), |out| {
            lines.iter().try_for_each(|line| writeln!(out, "{line}"))
        })?;
    }
    Ok(held)
}

/// The list files of a data set, which no other run writes while this is there.
#[derive(Debug)]
pub struct HeldLists {
    /// The root folder, locked while it is open; none where systems or file systems do not lock folders.
    _root: Option<File>,
}

impl HeldLists {
    fn of(root: &Path) -> Self {
        let folder = File::open(root).ok();
        Self {
            _root: folder.filter(|folder| folder.lock().is_ok()),
        }
    }
}

/// The lines of `old` without those that `ours` owns and `ids` does not have, each of `ids` once: those
/// that are new stand among ids in order, at the end of ids in another order.
fn merged(old: &str, ids: &[String], ours: impl Fn(&str) -> bool) -> Vec<String> {
    let mut seen = BTreeSet::new();
    let keeps = |line: &&str| {
        let name = line.trim();
        let listed = ids.iter().any(|id| id == name);
        name.is_empty() || (!listed && !ours(name)) || (listed && seen.insert(name.to_owned()))
    };
    let mut lines: Vec<String> = old.lines().filter(keeps).map(str::to_owned).collect();
    let is_id = |line: &&String| is_scene_id(line.trim()) || ids.iter().any(|id| id == line.trim());
    let in_order = lines
        .iter()
        .filter(is_id)
        .map(|line| line.trim())
        .is_sorted();
    for id in ids {
        if lines.iter().any(|line| line.trim() == id) {
            continue;
        }
        let after = |line: &String| in_order && is_id(&line) && line.trim() > id.as_str();
        let place = lines.iter().position(after).unwrap_or(lines.len());
        lines.insert(place, id.clone());
    }
    lines
}

/// The names of what a folder holds, in order.
///
/// # Errors
/// A folder that is not there or cannot be listed.
pub fn names_in(folder: &Path) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(folder).map_err(Error::io(folder, "read the folder"))?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(Error::io(folder, "read the folder"))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

/// Whether the name is that of an image that can be read; a hidden file (`._name`, which macOS keeps beside a file in
/// archives) is none.
pub fn is_image(name: &str) -> bool {
    let lower = name.to_ascii_lowercase();
    let hidden = name.starts_with('.');
    !hidden
        && [".jpg", ".jpeg", ".png"]
            .iter()
            .any(|end| lower.ends_with(end))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENES: [&str; 3] = [
        "aaaaaaaaaaaaaaaaaaaaaaaa",
        "cccccccccccccccccccccccc",
        "eeeeeeeeeeeeeeeeeeeeeeee",
    ];

    fn put(path: &Path, text: &str) {
        files::write_atomically(path, |out| out.write_all(text.as_bytes())).unwrap();
    }

    fn root_of(scenes: &[&str]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for scene in scenes {
            put(&BlendedFolder::new(root.path().join(scene)).pairs(), "0\n");
        }
        root
    }

    #[test]
    fn lists_are_the_scenes_in_order_whichever_was_made_first() {
        let [a, c, e] = SCENES;
        let root = root_of(&[c]);
        let list = |name: &str| std::fs::read_to_string(root.path().join(name)).unwrap();
        write_lists(root.path(), c, false).unwrap();
        for (scene, held_out) in [(e, true), (a, false)] {
            put(&BlendedFolder::new(root.path().join(scene)).pairs(), "0\n");
            write_lists(root.path(), scene, held_out).unwrap();
        }
        assert_eq!(list("all_list.txt"), format!("{a}\n{c}\n{e}\n"));
        assert_eq!(list("BlendedMVS_training.txt"), format!("{a}\n{c}\n"));
        assert_eq!(list("validation_list.txt"), format!("{e}\n"));
        // From one list to the other; the unfinished in none.
        write_lists(root.path(), e, false).unwrap();
        assert_eq!(list("validation_list.txt"), "");
        put(&root.path().join(c).join(UNFINISHED), "");
        write_lists(root.path(), a, true).unwrap();
        assert_eq!(list("training_list.txt"), format!("{e}\n"));
        assert_eq!(list("all_list.txt"), format!("{a}\n{e}\n"));
    }

    /// Each finishes its own while it holds the lists.
    #[cfg(unix)]
    #[test]
    fn scenes_made_side_by_side_are_all_listed() {
        let ids: Vec<String> = (0..12).map(|index| format!("{index:024x}")).collect();
        let held_out = |index: usize| index.is_multiple_of(3);
        for _ in 0..5 {
            let root = tempfile::tempdir().unwrap();
            for id in &ids {
                put(&root.path().join(id).join(UNFINISHED), "");
                put(&BlendedFolder::new(root.path().join(id)).pairs(), "0\n");
            }
            std::thread::scope(|scope| {
                for (index, id) in ids.iter().enumerate() {
                    let root = root.path();
                    scope.spawn(move || {
                        let held = write_lists(root, id, held_out(index)).unwrap();
                        std::fs::remove_file(root.join(id).join(UNFINISHED)).unwrap();
                        drop(held);
                    });
                }
            });
            let list = |name: &str| std::fs::read_to_string(root.path().join(name)).unwrap();
            let of = |counts: &dyn Fn(usize) -> bool| -> String {
                let listed = ids.iter().enumerate().filter(|(index, _)| counts(*index));
                listed.map(|(_, id)| format!("{id}\n")).collect()
            };
            assert_eq!(list("all_list.txt"), of(&|_| true));
            assert_eq!(list("validation_list.txt"), of(&held_out));
            assert_eq!(list("training_list.txt"), of(&|index| !held_out(index)));
            let names = names_in(root.path()).unwrap();
            assert_eq!(names.len(), ids.len() + LISTS.len(), "{names:?}");
        }
    }

    #[test]
    fn lines_that_are_not_ours_are_kept() {
        let [a, c, e] = SCENES;
        let root = root_of(&[c, e]);
        let foreign = ["ffffffffffffffffffffffff", "bbbbbbbbbbbbbbbbbbbbbbbb"];
        let own = format!("# mine\n{}\n\n{c}\n{}\n{c}\n", foreign[0], foreign[1]);
        let path = root.path().join("BlendedMVS_training.txt");
        put(&path, &own);
        let expected = format!("# mine\n{}\n\n{c}\n{}\n{e}\n", foreign[0], foreign[1]);
        for _ in 0..2 {
            write_lists(root.path(), e, false).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), expected);
        }
        // Foreign ids in order stay in order.
        let path = root.path().join("validation_list.txt");
        put(&path, &format!("{a}\n{}\n", foreign[0]));
        write_lists(root.path(), e, true).unwrap();
        let found = std::fs::read_to_string(&path).unwrap();
        assert_eq!(found, format!("{a}\n{e}\n{}\n", foreign[0]));
        let listed = listed_in(root.path()).unwrap();
        assert_eq!(listed.len(), 5, "{listed:?}");
    }
}
