//! The contact sheet: what went in and what came out, side by side.

use crate::error::Result;
use crate::jobs::OutDir;
use crate::report::contact_sheet::{self, SheetRow};
use mvs_datasets::format::image;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, Scene};
use std::path::Path;

const COLUMNS: [&str; 6] = [
    "input",
    "rendered",
    "blended",
    "masked",
    "true depth",
    "estimate",
];
const CELL_WIDTH: u32 = 256;
/// At most so many views are shown, spread evenly.
const ROWS: usize = 4;

/// Writes `contact_sheet.png`.
pub(super) fn write(out: &OutDir, scene: &Scene, folder: &Path, depths: &Path) -> Result<()> {
    let folder = BlendedFolder::new(folder);
    let views = scene.views();
    let step = views.len().div_ceil(ROWS).max(1);
    let mut rows: Vec<(String, [ColorImage; 6])> = Vec::new();
    for view in views.iter().step_by(step) {
        let (truth, _) = folder.read_depth(view.id)?;
        let name = mvs_datasets::layout::mvsnet::file_name(view.id, ".pfm");
        let (estimate, _) = files::read_depth(&depths.join(name))?;
        let images = [
            files::read_image(&folder.input_image(view.id))?,
            files::read_image(&folder.rendered_image(view.id))?,
            files::read_image(&folder.image(view.id))?,
            files::read_image(&folder.masked_image(view.id))?,
            contact_sheet::depth_image(&truth),
            contact_sheet::depth_image(&estimate),
        ];
        rows.push((format!("view {}", view.id), images));
    }
    let rows: Vec<SheetRow<'_>> = rows
        .iter()
        .map(|(label, images)| SheetRow {
            label: label.clone(),
            images: images.iter().map(Some).collect(),
        })
        .collect();
    let sheet = contact_sheet::draw(&COLUMNS, &rows, CELL_WIDTH)?;
    out.write("contact_sheet.png", |file| image::write_png(file, &sheet))
}
