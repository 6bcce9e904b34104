//! Where photographs come from.

use crate::error::{Error, Result};
use crate::parallel;
use crate::provenance;
use crate::render::Rendering;
use crate::warning::Warning;
use mvs_datasets::format::image;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, View};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// The photographs of a scene's views, of any size.
pub trait Photographs: Sync {
    /// The photograph that belongs to `view`. `rendering` is what the photograph will be blended
    /// with; a synthetic scene lights it.
    ///
    /// # Errors
    /// What stands in the way of reading or making it.
    fn photograph(&self, view: &View, rendering: &Rendering) -> Result<ColorImage>;

    /// What the photograph's content follows from: a hash of its file, say.
    ///
    /// # Errors
    /// What stands in the way of reading it.
    fn digest(&self, view: &View) -> Result<String>;

    /// The EXIF orientation that the photograph's file states, if it is not 1 (upright as stored).
    fn orientation(&self, _view: &View) -> Option<u8> {
        None
    }
}

/// Photographs in a folder: the file of the view's name, or of what stands in it behind the folder's own name
/// (`cam0/1.png` of `images/cam0/1.png` in `images`); else one of that name with another ending, or, where
/// the name has no image's ending, with one after it; else the same without the name's folder, which is looked for
/// only where no view's photograph lies in such a folder, so that none is taken from another's. Where no view's
/// photograph has its name, and for views without a name, the file of the view's eight-digit id.
#[derive(Debug, Clone)]
pub struct PhotoFolder {
    paths: BTreeMap<u32, PathBuf>,
    /// Photographs that were taken, each with one beside it that might be meant as well.
    doubtful: Vec<(PathBuf, PathBuf)>,
}

const ENDINGS: [&str; 9] = [
    "jpg", "jpeg", "JPG", "JPEG", "png", "PNG", "Jpg", "Jpeg", "Png",
];

/// Those of images that are not read, for which one of the others may lie there.
const OTHER_ENDINGS: [&str; 6] = ["tif", "tiff", "bmp", "webp", "heic", "exr"];

impl PhotoFolder {
    /// Finds the photograph of each view; the ones that are missing are named at once.
    ///
    /// # Errors
    /// No folder; views without a photograph, or two with the same; files that cannot be looked at, which is not the
    /// same as missing.
    pub fn open(folder: &Path, views: &[View]) -> Result<Self> {
        if !is(folder, std::fs::Metadata::is_dir)? {
            let problem = "expected a folder of photographs, found none";
            return Err(mvs_datasets::Error::layout(folder, problem).into());
        }
        let places = Places::of(folder, views)?;
        let (mut paths, mut doubtful) = (BTreeMap::new(), Vec::new());
        let mut owners: BTreeMap<PathBuf, &View> = BTreeMap::new();
        let mut missing = Vec::new();
        for view in views {
            let Some(path) = places.find(folder, view)? else {
                missing.push(view);
                continue;
            };
            if path != folder.join(&view.name)
                && let Some(other) = of_another_ending(&path)?
            {
                doubtful.push((path.clone(), other));
            }
            if let Some(other) = owners.insert(path.clone(), view) {
                return Err(taken_twice(&path, other, view));
            }
            paths.insert(view.id, path);
        }
        if let Some(first) = missing.first() {
            let other = of_other_format(folder, &first.name)?.map(|other| {
                format!(
                    "; {} is no JPEG or PNG: convert such photographs",
                    other.display()
                )
            });
            let problem = format!(
                "expected a photograph of each view, found none of {} of {} views; the first is {}{}",
                missing.len(),
                views.len(),
                places.expected_name(first),
                other.unwrap_or_default()
            );
            return Err(mvs_datasets::Error::layout(folder, problem).into());
        }
        Ok(Self { paths, doubtful })
    }

    /// The (width, height) in pixels that a view's photograph has.
    ///
    /// # Errors
    /// A view that was not among those of [`PhotoFolder::open`], and a photograph that cannot be read.
    pub fn size(&self, view: &View) -> Result<(u32, u32)> {
        Ok(files::read_with(self.path(view)?, image::read_size)?)
    }

    /// The files, by view id.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.paths.values().map(PathBuf::as_path)
    }

    /// Warnings where photographs are stored turned (their pixels are taken as stored), and where one could
    /// be meant as well that lies beside the one taken.
    pub fn warnings(&self) -> Vec<Warning> {
        let paths: Vec<&Path> = self.files().collect();
        let turned = turned_warning(&paths).into_iter();
        turned.chain(self.warning_of_doubtful()).collect()
    }

    fn warning_of_doubtful(&self) -> Option<Warning> {
        let (taken, other) = self.doubtful.first()?;
        let message = format!(
            "{} views have two photographs that differ in their ending; {} is taken, and {} is not: take \
             those that are not meant out of the folder",
            self.doubtful.len(),
            taken.display(),
            other.display()
        );
        Some(Warning::new("photograph-doubtful", message))
    }

    fn path(&self, view: &View) -> Result<&PathBuf> {
        let unknown = || Error::invalid(format!("view {}", view.id), "has no photograph");
        self.paths.get(&view.id).ok_or_else(unknown)
    }
}

/// Where photographs are looked for.
struct Places {
    /// Whether some lie in the folders that are part of their names.
    nested: bool,
    /// Whether some have their views' names, so that one with an id for a name is another's or none.
    named: bool,
}

impl Places {
    fn of(folder: &Path, views: &[View]) -> Result<Self> {
        let (mut nested, mut named) = (false, false);
        let inner = |view: &&View| !folder_of(&below(folder, &view.name)).is_empty();
        for view in views.iter().filter(inner) {
            nested = nested || find_named(folder, &view.name, true)?.is_some();
        }
        for view in views.iter().filter(|view| !view.name.is_empty()) {
            named = named || find_named(folder, &view.name, nested)?.is_some();
        }
        Ok(Self { nested, named })
    }

    fn find(&self, folder: &Path, view: &View) -> Result<Option<PathBuf>> {
        let nested = self.nested && !folder_of(&view.name).is_empty();
        match find_named(folder, &view.name, nested)? {
            None if view.name.is_empty() || !self.named => {
                with_ending(folder, &format!("{:08}", view.id))
            }
            found => Ok(found),
        }
    }

    fn expected_name(&self, view: &View) -> String {
        let id = format!("{:08}.jpg or .png", view.id);
        match (view.name.as_str(), self.named) {
            ("", _) => id,
            (name, true) => {
                format!("{name} or that with another ending (others are found by name)")
            }
            (name, false) => format!("{name} or {id}"),
        }
    }
}

/// The photograph of that name; else one of it with another ending, and, where folders are not `nested`, the same
/// without the name's folder.
pub(crate) fn find_named(folder: &Path, name: &str, nested: bool) -> Result<Option<PathBuf>> {
    let slashed = slashed(name);
    let below = below(folder, name);
    let names = [name, &slashed, &below];
    for name in names.into_iter().filter(|name| !name.is_empty()) {
        let named = folder.join(name);
        if is_file(&named)? {
            return Ok(Some(named));
        }
    }
    let stems = stems_of(Path::new(&slashed));
    let inside = [&slashed, &below].into_iter().flat_map(|name| {
        let inner = Path::new(folder_of(name));
        stems.iter().map(|stem| inner.join(stem))
    });
    let beside = stems.iter().map(PathBuf::from).filter(|_| !nested);
    for stem in inside.chain(beside) {
        if let Some(path) = with_ending(folder, &stem.display().to_string())? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// The photograph of that name and one of the endings.
fn with_ending(folder: &Path, stem: &str) -> Result<Option<PathBuf>> {
    for end in ENDINGS {
        let path = folder.join(format!("{stem}.{end}"));
        if is_file(&path)? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// A file of that name and an ending of images that are not read.
fn of_other_format(folder: &Path, name: &str) -> Result<Option<PathBuf>> {
    let below = below(folder, name);
    let base = below.rsplit('/').next().unwrap_or_default();
    for name in [below.as_str(), base]
        .into_iter()
        .filter(|name| !name.is_empty())
    {
        for end in OTHER_ENDINGS {
            let path = folder.join(name).with_extension(end);
            if is_file(&path)? {
                return Ok(Some(path));
            }
        }
    }
    Ok(None)
}

/// What endings may follow in a name: all before its own one; first all of it, where what follows its last
/// point is no image's ending.
fn stems_of(name: &Path) -> Vec<String> {
    let text = |part: &OsStr| part.to_string_lossy().into_owned();
    let ending = name.extension().unwrap_or_default();
    let is_images =
        (ENDINGS.iter().chain(&OTHER_ENDINGS)).any(|end| ending.eq_ignore_ascii_case(end));
    let whole = name.file_name().filter(|_| !is_images).map(text);
    let stem = name.file_stem().map(text);
    let stem = stem.filter(|stem| Some(stem) != whole.as_ref());
    whole.into_iter().chain(stem).collect()
}

/// A photograph of the same name whose ending is another one in whatever letters.
fn of_another_ending(path: &Path) -> Result<Option<PathBuf>> {
    let own = path.extension().unwrap_or_default();
    for end in ENDINGS.iter().filter(|end| !own.eq_ignore_ascii_case(end)) {
        let other = path.with_extension(end);
        if is_file(&other)? {
            return Ok(Some(other));
        }
    }
    Ok(None)
}

/// `a` of `a/b.jpg` or `a\b.jpg`, else nothing.
fn folder_of(name: &str) -> &str {
    let split = name.rsplit_once(['/', '\\']);
    split.map_or("", |(folder, _)| folder)
}

/// Some programs on Windows write `\` between folders.
fn slashed(name: &str) -> String {
    name.replace('\\', "/")
}

/// What stands in a name behind the folder's own, as `transforms.json` has names from the folder above; else all.
fn below(folder: &Path, name: &str) -> String {
    let name = slashed(name);
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
    let own = folder.file_name().unwrap_or_default().to_string_lossy();
    let mut parts = name.split('/');
    let is_there = parts.by_ref().any(|part| part == own);
    let rest: Vec<&str> = parts.collect();
    match is_there && !rest.is_empty() {
        true => rest.join("/"),
        false => name,
    }
}

fn is_file(path: &Path) -> Result<bool> {
    is(path, std::fs::Metadata::is_file)
}

/// Whether there is something of that kind; an error where that cannot be found out.
fn is(path: &Path, kind: fn(&std::fs::Metadata) -> bool) -> Result<bool> {
    match std::fs::metadata(path) {
        Ok(found) => Ok(kind(&found)),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Ok(false)
        }
        Err(error) => Err(mvs_datasets::Error::io(path, "look at")(error).into()),
    }
}

fn taken_twice(path: &Path, first: &View, second: &View) -> Error {
    let called = |view: &View| match view.name.is_empty() {
        true => format!("view {}", view.id),
        false => format!("view {} ({})", view.id, view.name),
    };
    let problem = format!(
        "expected a photograph of each view, found this one for both {} and {}",
        called(first),
        called(second)
    );
    mvs_datasets::Error::layout(path, problem).into()
}

impl Photographs for PhotoFolder {
    fn photograph(&self, view: &View, _rendering: &Rendering) -> Result<ColorImage> {
        Ok(files::read_image(self.path(view)?)?)
    }

    fn digest(&self, view: &View) -> Result<String> {
        provenance::hash_path(self.path(view)?)
    }

    fn orientation(&self, view: &View) -> Option<u8> {
        orientation_of(self.path(view).ok()?)
    }
}

/// A warning where photographs are stored turned: their pixels are taken as stored.
pub(crate) fn turned_warning(paths: &[&Path]) -> Option<Warning> {
    let turned = parallel::map(paths.len(), |index| orientation_of(paths[index]));
    let turned: Vec<(&Path, u8)> = (paths.iter().zip(turned))
        .filter_map(|(path, orientation)| Some((*path, orientation?)))
        .collect();
    warning_of_turned(&turned)
}

/// The same, where the turned ones and their EXIF orientations are known.
pub(crate) fn warning_of_turned(turned: &[(&Path, u8)]) -> Option<Warning> {
    let (first, orientation) = turned.first()?;
    let message = format!(
        "{} photographs say by EXIF that they are to be turned before they are shown; pixels are \
         taken as stored, as most photogrammetry does; the first is {} (orientation {orientation}): \
         if the cameras are for upright images, turn the pixels and take the tag off \
         (mogrify -auto-orient)",
        turned.len(),
        first.display(),
    );
    Some(Warning::new("exif-orientation", message))
}

/// So much of a file holds the head of its image, as a rule.
const HEAD: u64 = 1 << 18;

/// The EXIF orientation of a file, if it states one that is not 1; files that are no images have none.
pub(crate) fn orientation_of(path: &Path) -> Option<u8> {
    let read = |most: u64| {
        let mut bytes = Vec::new();
        let file = std::fs::File::open(path).ok()?;
        file.take(most).read_to_end(&mut bytes).ok()?;
        image::read_orientation(&bytes).ok()
    };
    let orientation = read(HEAD).or_else(|| read(u64::MAX))?;
    (orientation != 1).then_some(orientation)
}

/// As [`orientation_of`] of a whole file's bytes.
pub(crate) fn orientation_in(bytes: &[u8]) -> Option<u8> {
    let head = &bytes[..bytes.len().min(HEAD as usize)];
    let read = image::read_orientation(head).or_else(|_| image::read_orientation(bytes));
    read.ok().filter(|orientation| *orientation != 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;
    use mvs_datasets::scene::{Camera, Pose};
    use std::io::Write;

    fn view(id: u32, name: &str) -> View {
        View {
            id,
            name: name.to_owned(),
            camera: Camera::new(4, 3, DVec2::ONE, DVec2::ONE).unwrap(),
            pose: Pose::IDENTITY,
            depth_range: None,
        }
    }

    fn touch(path: &Path) {
        files::write_atomically(path, |_| Ok(())).unwrap();
    }

    #[test]
    fn photographs_are_found_by_name_then_by_id_and_missing_ones_named() {
        let folder = tempfile::tempdir().unwrap();
        let views = [view(0, "a/left.jpg"), view(1, "right.tif"), view(12, "")];
        for name in ["a/left.jpg", "right.PNG", "00000012.jpeg"] {
            touch(&folder.path().join(name));
        }
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        assert_eq!(photos.paths[&1], folder.path().join("right.PNG"));
        assert_eq!(photos.paths[&12], folder.path().join("00000012.jpeg"));
        let more = [views[0].clone(), view(3, "x.jpg"), view(4, "")];
        let error = PhotoFolder::open(folder.path(), &more)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("2 of 3 views") && error.contains("x.jpg"),
            "{error}"
        );
        assert!(!error.contains("convert"), "{error}");
        touch(&folder.path().join("x.tif"));
        let error = PhotoFolder::open(folder.path(), &more).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("x.tif is no JPEG or PNG"), "{error}");
    }

    #[test]
    fn a_point_in_a_name_without_an_ending_is_part_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let names = [
            "cam.0001.jpg",
            "cam.0002.png",
            "b.v1/frame.7.jpg",
            "d.jpg",
            "d.tif.jpg",
        ];
        for name in names {
            touch(&folder.path().join(name));
        }
        let views = ["cam.0001", "cam.0002", "b.v1/frame.7", "d.tif"];
        let views: Vec<View> = (0..).zip(views).map(|(id, name)| view(id, name)).collect();
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        let found = names[..4].iter().map(|name| folder.path().join(name));
        assert!(photos.files().eq(found), "{:?}", photos.paths);
    }

    #[test]
    fn names_that_begin_with_the_photographs_folder_are_found_in_it() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("images");
        let names = ["cam0/0001.png", "cam1/0001.JPG", "0002.png"];
        for name in names {
            touch(&folder.join(name));
        }
        let expected = names.map(|name| folder.join(name));
        for views in [
            [
                "images/cam0/0001.png",
                "images/cam1/0001.png",
                "images/0002",
            ],
            [
                "data/images/cam0/0001",
                "images\\cam1\\0001.JPG",
                "./images/0002.png",
            ],
        ] {
            let views: Vec<View> = (0..).zip(views).map(|(id, name)| view(id, name)).collect();
            let photos = PhotoFolder::open(&folder, &views).unwrap();
            assert!(photos.files().eq(&expected), "{:?}", photos.paths);
            // From the folder above as well.
            if views[0].name.starts_with("images") {
                let photos = PhotoFolder::open(root.path(), &views).unwrap();
                assert!(photos.files().eq(&expected), "{:?}", photos.paths);
            }
        }
    }

    #[test]
    fn a_photograph_beside_the_one_taken_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let views = [view(0, ""), view(1, ""), view(2, "c.png")];
        for name in [
            "00000000.jpg",
            "00000000.png",
            "00000001.PNG",
            "c.png",
            "c.jpg",
        ] {
            touch(&folder.path().join(name));
        }
        // c.png is asked for by its whole name.
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        let warnings = photos.warnings();
        assert_eq!(warnings.len(), 1);
        assert_eq!(warnings[0].code, "photograph-doubtful");
        let said = &warnings[0].message;
        assert!(
            said.starts_with("1 views") && said.contains("00000000.png is not"),
            "{said}"
        );
    }

    #[test]
    fn no_photograph_is_taken_for_two_views() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |views: &[View], parts: &[&str]| {
            let error = PhotoFolder::open(folder.path(), views).unwrap_err();
            let error = error.to_string();
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        };
        touch(&folder.path().join("00000000.jpg"));
        let twins = [view(0, "00000000.jpg"), view(1, "camA/00000000.jpg")];
        let both = ["view 0 (00000000.jpg)", "view 1 (camA/00000000.jpg)"];
        refused(&twins, &both);
        refused(
            &[view(3, "00000000.jpg"), view(5, "00000000.jpg")],
            &["view 3", "view 5"],
        );
        // With the folder left out in all names, each has its own.
        let one = [view(1, "images/00000000.jpg")];
        assert!(PhotoFolder::open(folder.path(), &one).is_ok());
        // Where folders mean something, the photograph of another one is not taken.
        touch(&folder.path().join("camB/00000000.jpg"));
        let rig = [view(0, "camA/00000000.jpg"), view(1, "camB/00000000.jpg")];
        refused(&rig, &["1 of 2 views", "camA/00000000.jpg"]);
        touch(&folder.path().join("camA/00000000.png"));
        let photos = PhotoFolder::open(folder.path(), &rig).unwrap();
        let expected = ["camA/00000000.png", "camB/00000000.jpg"];
        let expected = expected.map(|name| folder.path().join(name));
        assert!(photos.files().eq(&expected));
    }

    /// Where a view's photograph has its name, one with an id for a name may be anything.
    #[test]
    fn ids_are_names_only_where_no_photograph_has_its_view_s_name() {
        let folder = tempfile::tempdir().unwrap();
        let views = [view(0, "f1.jpg"), view(1, "f2.jpg"), view(2, "")];
        for name in ["00000000.jpg", "00000001.jpg", "00000002.jpg"] {
            touch(&folder.path().join(name));
        }
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        assert_eq!(photos.paths[&0], folder.path().join("00000000.jpg"));
        touch(&folder.path().join("f2.png"));
        let error = PhotoFolder::open(folder.path(), &views).unwrap_err();
        let said = error.to_string();
        assert!(
            said.contains("1 of 3 views") && said.contains("f1.jpg or that"),
            "{said}"
        );
        touch(&folder.path().join("f1.jpg"));
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        let expected = ["f1.jpg", "f2.png", "00000002.jpg"].map(|name| folder.path().join(name));
        assert!(photos.files().eq(&expected), "{:?}", photos.paths);
    }

    #[test]
    fn names_with_backslashes_and_endings_in_mixed_letters_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let views = [
            view(0, "left\\a.jpg"),
            view(1, "right\\a.tif"),
            view(2, "c.jpg"),
        ];
        let names = ["left/a.jpg", "right/a.Png", "c.Jpg"];
        for name in names {
            touch(&folder.path().join(name));
        }
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        let expected = names.map(|name| folder.path().join(name));
        assert!(photos.files().eq(&expected), "{:?}", photos.paths);
    }

    #[test]
    fn folders_mean_something_where_photographs_lie_in_them_with_another_ending() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["camA/a.png", "camB/b.png", "a.png"] {
            touch(&folder.path().join(name));
        }
        let rig = [
            view(0, "camA/a.jpg"),
            view(1, "camB/a.jpg"),
            view(2, "camB/b.jpg"),
        ];
        let error = PhotoFolder::open(folder.path(), &rig)
            .unwrap_err()
            .to_string();
        assert!(error.contains("1 of 3 views"), "{error}");
        assert!(
            error.contains("camB/a.jpg or that with another ending"),
            "{error}"
        );
    }

    /// A JPEG whose EXIF says this orientation.
    fn turned(orientation: u8) -> Vec<u8> {
        let mut jpeg = Vec::new();
        let picture = ColorImage::filled(4, 3, [90; 3]).unwrap();
        image::write_jpeg(&mut jpeg, &picture, image::JpegOptions::default()).unwrap();
        let mut exif = b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0".to_vec();
        exif.extend(b"\x12\x01\x03\0\x01\0\0\0"); // orientation, one u16
        exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        jpeg.splice(2..2, exif);
        jpeg
    }

    #[test]
    fn photographs_that_are_stored_turned_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let views = [view(0, ""), view(1, ""), view(2, "")];
        let put = |id: u32, orientation| {
            let path = folder.path().join(format!("{id:08}.jpg"));
            files::write_atomically(&path, |out| out.write_all(&turned(orientation))).unwrap();
        };
        for id in 0..3 {
            put(id, 1);
        }
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        assert_eq!(photos.warnings(), []);
        for orientation in 2..=8 {
            put(1, orientation);
            assert_eq!(photos.orientation(&views[1]), Some(orientation));
        }
        put(2, 3);
        let said = &photos.warnings()[0].message;
        assert!(said.starts_with("2 photographs"), "{said}");
        assert!(said.contains("00000001.jpg (orientation 8)"), "{said}");
        assert_eq!(photos.orientation(&views[0]), None);
    }

    #[cfg(unix)]
    #[test]
    fn what_cannot_be_looked_at_is_not_called_missing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("00000000.jpg");
        std::os::unix::fs::symlink(&path, &path).unwrap(); // to itself
        let error = PhotoFolder::open(folder.path(), &[view(0, "")]).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("cannot look at") && !error.contains("found none"),
            "{error}"
        );
    }
}
