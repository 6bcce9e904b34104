//! Material libraries and textures, found the way people ship them.

use super::files::read_with;
use super::mesh::ReadOptions;
use super::textures::{Textures, Use};
use crate::error::Result;
use crate::format::mtl::{MtlMaterial, read_mtl};
use crate::format::obj::MaterialUse;
use crate::scene::{Corner, Material};
use glam::Vec2;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};

/// What the materials of meshes need from files, and what was odd about them.
#[derive(Debug, Default)]
pub(super) struct Library {
    textures: Textures,
    notes: Vec<String>,
    files: BTreeSet<PathBuf>,
}

/// What has become of the drafts.
pub(super) struct Finished {
    /// One per draft.
    pub(super) materials: Vec<Material>,
    /// Sentences for the user.
    pub(super) notes: Vec<String>,
    /// Every file that was used, by path.
    pub(super) files: Vec<PathBuf>,
}

/// A material whose textures are still to be read.
#[derive(Debug, Clone, Default)]
pub(super) struct Draft {
    pub(super) material: Material,
    /// The number of its texture.
    pub(super) texture: Option<usize>,
    /// The number of the image with its opacity, and the least that is surface, in 0…1.
    pub(super) opacity: Option<(usize, f64)>,
}

impl From<Material> for Draft {
    fn from(material: Material) -> Self {
        Self {
            material,
            ..Self::default()
        }
    }
}

/// The materials that one mesh file may use, by name, with the library file that states each.
pub(super) type KnownMaterials = BTreeMap<String, (MtlMaterial, PathBuf)>;

/// How texture coordinates are moved by a material's texture options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placement {
    scale: Vec2,
    offset: Vec2,
}

impl Placement {
    const IDENTITY: Self = Self {
        scale: Vec2::ONE,
        offset: Vec2::ZERO,
    };

    /// Moves a triangle's coordinates.
    pub(super) fn apply(&self, corners: &mut Corner) {
        *corners = corners.map(|coord| coord * self.scale + self.offset);
    }
}

impl Library {
    /// Adds a sentence about `path`, unless it has been said.
    pub(super) fn note(&mut self, path: &Path, problem: impl std::fmt::Display) {
        let note = format!("{}: {problem}", path.display());
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Remembers that the result follows from this file.
    pub(super) fn uses(&mut self, path: &Path) {
        self.files.insert(path.to_path_buf());
    }

    /// Reads the textures of all drafts and returns the materials, what was odd and what was used.
    pub(super) fn finish(mut self, drafts: Vec<Draft>, options: &ReadOptions) -> Result<Finished> {
        let images = self.textures.read(options, &mut self.notes)?;
        let finished = drafts.into_iter().map(|draft| images.finish(draft));
        Ok(Finished {
            materials: finished.collect(),
            notes: self.notes,
            files: self.files.into_iter().collect(),
        })
    }

    /// The materials in the libraries that `mesh` names. One that is missing is noted when
    /// `wanted`. Of two materials with one name the first counts.
    pub(super) fn read(
        &mut self,
        mesh: &Path,
        libraries: &[String],
        wanted: bool,
    ) -> Result<KnownMaterials> {
        let mut known = KnownMaterials::new();
        for text in libraries {
            for name in library_names(mesh, text) {
                let Some(path) = find(&[mesh], &name) else {
                    if wanted {
                        self.note(mesh, format!("the material library {name:?} is missing"));
                    }
                    continue;
                };
                self.uses(&path);
                for material in read_with(&path, read_mtl)? {
                    let entry = known.entry(material.name.clone());
                    entry.or_insert_with(|| (material, path.clone()));
                }
            }
        }
        Ok(known)
    }

    /// The material that faces of `mesh` use, and how its texture lies.
    pub(super) fn material(
        &mut self,
        mesh: &Path,
        known: &KnownMaterials,
        used: &MaterialUse,
    ) -> (Draft, Placement) {
        let mut draft = Draft::from(Material {
            name: used.name.clone(),
            ..Material::default()
        });
        let mut placement = Placement::IDENTITY;
        let Some((stated, library)) = stated_of(known, &used.name) else {
            if !used.name.is_empty() && !known.is_empty() {
                self.note(
                    mesh,
                    format!("the material {:?} is in none of its libraries", used.name),
                );
            }
            return (draft, placement);
        };
        draft.material.color = stated.color.unwrap_or(draft.material.color);
        if stated.transparent {
            self.note(
                library,
                "transparent materials (d below 1) are shown opaque",
            );
        }
        if (stated.texture.is_some() || stated.mask.is_some()) && !used.textured {
            let name = &used.name;
            self.note(
                mesh,
                format!("faces of material {name:?} lack texture coordinates"),
            );
        }
        if let Some(texture) = stated.texture.as_ref().filter(|_| used.textured) {
            draft.texture = self.texture_of(&[library, mesh], &texture.file, Use::Color);
            if texture.clamped {
                let name = &used.name;
                self.note(
                    library,
                    format!(
                        "the texture of material {name:?} is to be clamped (-clamp on), but is repeated where \
                         coordinates go beyond it"
                    ),
                );
            }
            if texture.levels != [0.0, 1.0] {
                let name = &used.name;
                self.note(
                    library,
                    format!(
                        "the texture of material {name:?} is shown without its -mm (base and gain)"
                    ),
                );
            }
            placement = Placement {
                scale: texture.scale,
                offset: texture.offset,
            };
        }
        if let Some(mask) = stated.mask.as_ref().filter(|_| used.textured) {
            // Nobody cuts a picture by its own brightness: one that is shown as well is cut by its alpha.
            let shown = stated.texture.as_ref().map(|texture| &texture.file);
            let used_for = match mask.channel {
                None if shown == Some(&mask.file) => Use::Opacity,
                channel => Use::Mask(channel),
            };
            let number = self.texture_of(&[library, mesh], &mask.file, used_for);
            draft.opacity = number.map(|number| (number, 0.5));
            let own = Placement {
                scale: mask.scale,
                offset: mask.offset,
            };
            if draft.texture.is_none() {
                placement = own;
            } else if own != placement {
                let name = &used.name;
                self.note(
                    library,
                    format!(
                        "the map_d of material {name:?} has other options (-s, -o) than its map_Kd, by whose both lie"
                    ),
                );
            }
        }
        (draft, placement)
    }

    /// The number of the texture that `mesh` names, if there is such a file.
    pub(super) fn texture(&mut self, mesh: &Path, name: &str, used: Use) -> Option<usize> {
        self.texture_of(&[mesh], name, used)
    }

    /// The number of a texture inside `mesh`.
    pub(super) fn inner_texture(
        &mut self,
        (mesh, image): (&Path, usize),
        bytes: &[u8],
        used: Use,
    ) -> usize {
        let name = format!("{} (image {image})", mesh.display());
        self.textures.add(PathBuf::from(name), Some(bytes), used)
    }

    /// The texture `name`, looked for beside each of the files `beside`.
    fn texture_of(&mut self, beside: &[&Path], name: &str, used: Use) -> Option<usize> {
        let found = find(beside, name).or_else(|| find(beside, before_comment(name)?));
        let Some(path) = found else {
            let from = beside.first().copied().unwrap_or(Path::new(""));
            self.note(
                from,
                format!("the texture {name:?} is missing; {}", used.instead()),
            );
            return None;
        };
        self.uses(&path);
        let path = path.canonicalize().unwrap_or(path);
        Some(self.textures.add(path, None, used))
    }
}

/// What stands before a comment behind a name: ` # ` is seldom part of one.
fn before_comment(name: &str) -> Option<&str> {
    name.split_once(" # ").map(|(before, _)| before.trim_end())
}

/// The material of that name, with a comment behind it in either file or not.
fn stated_of<'a>(known: &'a KnownMaterials, name: &str) -> Option<&'a (MtlMaterial, PathBuf)> {
    let bare = before_comment(name).unwrap_or(name);
    let with_comment = || {
        let mut all = known.iter();
        let found = all.find(|(stated, _)| before_comment(stated) == Some(bare));
        found.map(|(_, material)| material)
    };
    let exact = known.get(name).or_else(|| known.get(bare));
    exact.or_else(with_comment)
}

/// The files that the text after one `mtllib` means: one, if there is a file of that name with all
/// its spaces; else several that end in `.mtl`.
fn library_names(mesh: &Path, text: &str) -> Vec<String> {
    let unescaped = text.replace("\\ ", " ");
    if text.is_empty() || find(&[mesh], &unescaped).is_some() {
        return if text.is_empty() {
            Vec::new()
        } else {
            vec![unescaped]
        };
    }
    let lower = unescaped.to_ascii_lowercase();
    let mut names = Vec::new();
    let mut start = 0;
    for (end, _) in lower.match_indices(".mtl ") {
        names.push(unescaped[start..end + 4].trim().to_owned());
        start = end + 5;
    }
    names.push(unescaped[start..].trim().to_owned());
    names.retain(|name| !name.is_empty());
    names
}

/// The file `name` beside one of the files `beside`: with its folders or without, as written or in
/// another case, with the separators of either system, in quotes or not.
pub(super) fn find(beside: &[&Path], name: &str) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    let quoted = name
        .strip_prefix('"')
        .and_then(|rest| rest.strip_suffix('"'));
    find_plain(beside, &name).or_else(|| find_plain(beside, quoted?))
}

fn find_plain(beside: &[&Path], name: &str) -> Option<PathBuf> {
    let relative = Path::new(name);
    let alone = relative.file_name().map(Path::new);
    let folders = beside
        .iter()
        .map(|file| file.parent().unwrap_or(Path::new("")));
    let candidates: Vec<(&Path, &Path)> = folders
        .flat_map(|folder| {
            let names = [Some(relative), alone].into_iter().flatten();
            names.map(move |name| (folder, name))
        })
        .collect();
    let mut exact = candidates.iter().map(|(folder, name)| folder.join(name));
    let exact = exact.find(|path| path.is_file());
    let mut candidates = candidates.iter();
    exact.or_else(|| candidates.find_map(|(folder, name)| in_any_case(folder, name)))
}

/// The file `name`, with its folders, in `folder`, each of them in any case.
fn in_any_case(folder: &Path, name: &Path) -> Option<PathBuf> {
    let mut parts = name.components().peekable();
    let mut found = folder.to_path_buf();
    while let Some(part) = parts.next() {
        let as_written = found.join(part);
        let is_last = parts.peek().is_none();
        let fits = |path: &Path| match is_last {
            true => path.is_file(),
            false => path.is_dir(),
        };
        found = match part {
            Component::Normal(wanted) if !fits(&as_written) => {
                entry_in_any_case(&found, wanted, fits)?
            }
            _ => as_written,
        };
    }
    Some(found).filter(|path| path.is_file())
}

/// The first in order of names of those in `folder` that are `wanted` in any case and that fit.
fn entry_in_any_case(
    folder: &Path,
    wanted: &OsStr,
    fits: impl Fn(&Path) -> bool,
) -> Option<PathBuf> {
    let folder = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let entries = std::fs::read_dir(folder).ok()?;
    let mut matches: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|found| {
            let name = found.file_name();
            name.is_some_and(|name| name.eq_ignore_ascii_case(wanted)) && fits(found)
        })
        .collect();
    matches.sort();
    matches.into_iter().next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::files::write_atomically;
    use std::io::Write;

    #[test]
    fn files_are_found_in_any_case_and_by_either_separator() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str| {
            write_atomically(&folder.path().join(name), |out| out.write_all(b"x")).unwrap();
        };
        put("Tex 01.PNG");
        put("images/b.jpg");
        let mesh = folder.path().join("m.obj");
        for name in [
            "Tex 01.PNG",
            "tex 01.png",
            ".\\TEX 01.png",
            "C:\\elsewhere\\Tex 01.PNG",
        ] {
            let found = find(&[&mesh], name).unwrap();
            assert_eq!(found.file_name().unwrap(), "Tex 01.PNG", "{name}");
        }
        for name in [
            "images\\b.jpg",
            "Images/B.jpg",
            "\"images/b.jpg\"",
            "./IMAGES/../images/b.JPG",
        ] {
            let found = find(&[&mesh], name).unwrap();
            assert_eq!(std::fs::read(&found).unwrap(), b"x", "{name}");
            assert!(found.ends_with("images/b.jpg"), "{name}");
        }
        assert!(find(&[&folder.path().join("images/x.mtl"), &mesh], "b.jpg").is_some());
        assert_eq!(find(&[&mesh], "c.jpg"), None);
        assert_eq!(find(&[&mesh], ""), None);
    }

    /// `Material #25` is a name.
    #[test]
    fn comments_behind_names_are_passed_over() {
        let known = |names: &[&str]| -> KnownMaterials {
            let material = |name: &&str| MtlMaterial {
                name: (*name).to_owned(),
                color: None,
                texture: None,
                mask: None,
                transparent: false,
            };
            let entry = |name: &&str| ((*name).to_owned(), (material(name), PathBuf::new()));
            names.iter().map(entry).collect()
        };
        let all = known(&["red", "blue # sea", "a # b", "Material #25"]);
        let of = |name: &str| stated_of(&all, name).map(|(material, _)| material.name.as_str());
        for (name, found) in [
            ("red # c", Some("red")),
            ("blue", Some("blue # sea")),
            ("blue # sky", Some("blue # sea")),
            ("a # b", Some("a # b")),
            ("Material #25", Some("Material #25")),
            ("Material #26", None),
            ("Material", None),
        ] {
            assert_eq!(of(name), found, "{name}");
        }
    }

    #[test]
    fn one_line_names_one_library_with_spaces_or_several() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = folder.path().join("m.obj");
        let both = "a b.mtl c d.MTL";
        assert_eq!(library_names(&mesh, both), ["a b.mtl", "c d.MTL"]);
        assert_eq!(
            library_names(&mesh, "x\\ y.mtl  z.mtl"),
            ["x y.mtl", "z.mtl"]
        );
        assert!(library_names(&mesh, "").is_empty());
        write_atomically(&folder.path().join(both), |out| out.write_all(b"")).unwrap();
        assert_eq!(library_names(&mesh, both), [both]);
        let quoted = format!("\"{both}\"");
        let names = library_names(&mesh, &quoted);
        assert!(
            matches!(&names[..], [name] if find(&[&mesh], name).is_some()),
            "{names:?}"
        );
    }
}
