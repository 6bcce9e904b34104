//! Where photographs come from.

mod names;

pub(crate) use names::find_named;

use crate::error::{Error, Result};
use crate::parallel;
use crate::provenance;
use crate::render::Rendering;
use crate::warning::Warning;
use mvs_datasets::format::image;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, View};
use names::{below, folder_of, is, of_another_ending, of_other_format, with_ending};
use std::collections::BTreeMap;
use std::io::Read;
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
mod tests;
