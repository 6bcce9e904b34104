//! How a data set is spoilt.

use super::*;

pub(super) const CAM_1: &str = "cams/00000001_cam.txt";
pub(super) const CAM_2: &str = "cams/00000002_cam.txt";
pub(super) const PAIR: &str = "cams/pair.txt";

pub(super) fn edit_line(spoilt: &Spoilt, name: &str, index: usize, edit: fn(&str) -> String) {
    spoilt.edit(name, |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines[index] = edit(&lines[index]);
        lines.join("\n") + "\n"
    });
}

/// The first view's sources become `line`.
pub(super) fn sources(spoilt: &Spoilt, line: &str) {
    spoilt.edit(PAIR, |text| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[2] = line;
        lines.join("\n") + "\n"
    });
}

pub(super) fn cut_last(line: &str) -> String {
    line.rsplit_once(' ').unwrap().0.to_owned()
}

pub(super) fn drop_last_reference(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let kept = &lines[1..lines.len() - 2];
    format!("{}\n{}\n", kept.len() / 2, kept.join("\n"))
}

pub(super) fn remove(spoilt: &Spoilt, name: &str) {
    std::fs::remove_file(spoilt.path(name)).unwrap();
}

pub(super) fn flip() -> DMat4 {
    DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0))
}

pub(super) fn scale(cam: &mut CamFile, scale: f64) {
    cam.intrinsic.x_axis.x *= scale;
    cam.intrinsic.y_axis.y *= scale;
    cam.intrinsic.z_axis.x *= scale;
    cam.intrinsic.z_axis.y *= scale;
}

pub(super) fn edit_cam(spoilt: &Spoilt, id: u32, edit: impl Fn(&mut CamFile)) {
    let path = spoilt.blended().cam(id);
    let mut cam = cam::read(&std::fs::read_to_string(&path).unwrap()).unwrap();
    edit(&mut cam);
    files::write_atomically(&path, |out| cam::write(out, &cam)).unwrap();
}

/// A depth, its column, the length of its pixel's ray at depth 1, and its view.
pub(super) struct Value {
    pub(super) id: u32,
    pub(super) value: f32,
    pub(super) column: u32,
    pub(super) ray: f32,
}

pub(super) fn edit_depths(spoilt: &Spoilt, ids: std::ops::Range<u32>, edit: fn(Value) -> f32) {
    let scene = spoilt.blended().read_scene(None).unwrap();
    for id in ids {
        let view = &scene.views()[scene.index_of(id).unwrap()];
        let (depth, _) = spoilt.blended().read_depth(id).unwrap();
        let (width, height) = depth.size();
        let value = |i: u32| {
            let pixel = DVec2::new(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
            edit(Value {
                id,
                value: depth.get(i % width, i / width),
                column: i % width,
                ray: view.camera.ray(pixel).length() as f32,
            })
        };
        let values = (0..width * height).map(value).collect();
        let edited = DepthMap::from_values(width, height, values).unwrap().0;
        spoilt.blended().write_depth(id, &edited).unwrap();
    }
}

/// A depth map with one value that no depth has.
pub(super) fn raw_depth(spoilt: &Spoilt, value: f32) {
    let (depth, _) = spoilt.blended().read_depth(6).unwrap();
    let mut values = depth.values().to_vec();
    values[77] = value;
    let raster = Raster::from_values(128, 96, values).unwrap();
    let path = spoilt.blended().depth(6);
    files::write_atomically(&path, |out| pfm::write_gray(out, &raster)).unwrap();
}

/// Two fifths of the range off at either end.
pub(super) fn narrow_range(spoilt: &Spoilt) {
    edit_cam(spoilt, 1, |cam| {
        let (min, max) = cam.depth_range().unwrap();
        let (min, max) = (0.6 * min + 0.4 * max, 0.4 * min + 0.6 * max);
        cam.tail = vec![min, (max - min) / 128.0, 128.0, max];
    });
}

/// One view's files, of one size, which the others have not.
pub(super) fn another_size(spoilt: &Spoilt) {
    let folder = spoilt.blended();
    let image = ColorImage::filled(64, 48, [90; 3]).unwrap();
    for path in [folder.image(3), folder.masked_image(3)] {
        BlendedFolder::write_jpeg(&path, &image, JpegOptions::default()).unwrap();
    }
    let depth = DepthMap::from_values(64, 48, vec![2.0; 64 * 48]).unwrap().0;
    folder.write_depth(3, &depth).unwrap();
}

/// A tenth of the background is not as dark as it should be.
pub(super) fn spotted(spoilt: &Spoilt) {
    let folder = spoilt.blended();
    let (depth, _) = folder.read_depth(3).unwrap();
    let mut image = files::read_image(&folder.masked_image(3)).unwrap();
    let outside = depth.values().iter().filter(|&&z| z == 0.0).count();
    let pixels = image.values_mut().iter_mut().zip(depth.values());
    let background = pixels.filter(|(_, z)| **z == 0.0).take(outside / 10);
    background.for_each(|(pixel, _)| *pixel = [30; 3]);
    BlendedFolder::write_jpeg(&folder.masked_image(3), &image, JpegOptions::default()).unwrap();
}

pub(super) fn black_mask(spoilt: &Spoilt) {
    let black = ColorImage::filled(128, 96, [0; 3]).unwrap();
    let path = spoilt.blended().masked_image(3);
    BlendedFolder::write_jpeg(&path, &black, JpegOptions::default()).unwrap();
}

/// A square of 12 pixels in the middle of a masked image, a twentieth of what it shows.
pub(super) fn painted(spoilt: &Spoilt, color: [u8; 3]) {
    let path = spoilt.blended().masked_image(4);
    let masked = files::read_image(&path).unwrap();
    let is_inside =
        |index: usize| (58..70).contains(&(index % 128)) && (42..54).contains(&(index / 128));
    let pixels = masked.values().iter().enumerate();
    let pixels = pixels.map(|(index, &pixel)| if is_inside(index) { color } else { pixel });
    let masked = ColorImage::from_values(128, 96, pixels.collect()).unwrap();
    BlendedFolder::write_jpeg(&path, &masked, JpegOptions::default()).unwrap();
}

/// One camera, by about two pixels.
pub(super) fn along_the_table(spoilt: &Spoilt) {
    edit_cam(spoilt, 5, |cam| {
        let along = cam.extrinsic * DVec3::new(0.05, 0.0, 0.0).extend(0.0);
        cam.extrinsic.w_axis -= along;
    });
}

/// Images five views on.
pub(super) fn other_images(spoilt: &Spoilt) {
    move_images(spoilt, 5);
}

pub(super) fn move_images(spoilt: &Spoilt, by: usize) {
    let image = |id: u32| spoilt.blended().image(id);
    let all: Vec<Vec<u8>> = (0..14)
        .map(|id| std::fs::read(image(id)).unwrap())
        .collect();
    for id in 0..14 {
        write(&image(id), &all[(id as usize + by) % 14]);
    }
}

/// Edits the pixels of the images and the masked images of these views.
pub(super) fn edit_images(spoilt: &Spoilt, ids: std::ops::Range<u32>, edit: fn(&mut [[u8; 3]])) {
    for id in ids {
        for path in [
            spoilt.blended().image(id),
            spoilt.blended().masked_image(id),
        ] {
            let mut image = files::read_image(&path).unwrap();
            edit(image.values_mut());
            BlendedFolder::write_jpeg(&path, &image, JpegOptions::default()).unwrap();
        }
    }
}

/// Each view has the sources of the one seven views on.
pub(super) fn shuffled(spoilt: &Spoilt) {
    spoilt.edit(PAIR, |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let rows: Vec<String> = lines.iter().skip(2).step_by(2).cloned().collect();
        for (index, line) in lines.iter_mut().skip(2).step_by(2).enumerate() {
            line.clone_from(&rows[(index + 7) % rows.len()]);
        }
        lines.join("\n") + "\n"
    });
}

/// Only these views are left, and in the lists.
pub(super) fn keep(spoilt: &Spoilt, kept: &[u32]) {
    let folder = spoilt.blended();
    let mut pairs = pair::read(&std::fs::read_to_string(folder.pairs()).unwrap()).unwrap();
    pairs.retain(|entry| kept.contains(&entry.id));
    for entry in &mut pairs {
        let others = kept.iter().filter(|&&id| id != entry.id);
        entry.sources = others.map(|&id| SourceScore { id, score: 1.0 }).collect();
    }
    files::write_atomically(&folder.pairs(), |out| pair::write(out, &pairs)).unwrap();
    for id in (0..14).filter(|id| !kept.contains(id)) {
        for path in [
            folder.cam(id),
            folder.depth(id),
            folder.image(id),
            folder.masked_image(id),
        ] {
            std::fs::remove_file(path).unwrap();
        }
    }
}

/// A view's camera turned to the side.
pub(super) fn turn(spoilt: &Spoilt, id: u32, degrees: f64) {
    let turned = DMat4::from_rotation_y(degrees.to_radians());
    edit_cam(spoilt, id, |cam| cam.extrinsic = turned * cam.extrinsic);
}

/// All images some pixels to the right of where the depths are.
pub(super) fn moved_images(spoilt: &Spoilt) {
    edit_images(spoilt, 0..14, |pixels| pixels.rotate_right(5));
}

/// One view's image in grey, of one channel.
pub(super) fn gray_image(spoilt: &Spoilt) {
    let path = spoilt.blended().image(3);
    let gray = files::read_image(&path).unwrap();
    let values = gray.values().iter().map(|pixel| pixel[1]).collect();
    let gray = Raster::from_values(128, 96, values).unwrap();
    files::write_atomically(&path, |out| image::write_gray_png(out, &gray)).unwrap();
}

/// One view's image with a note that it lies on its head.
pub(super) fn turned_by_note(spoilt: &Spoilt) {
    let path = spoilt.blended().image(3);
    let bytes = std::fs::read(&path).unwrap();
    let note = b"\xff\xe1\x00\x22Exif\0\0II\x2a\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x03\0\0\0\0\0\0\0";
    write(&path, &[&bytes[..2], note, &bytes[2..]].concat());
}

/// One view's files are those of another.
pub(super) fn view_again(spoilt: &Spoilt) {
    let folder = spoilt.blended();
    for of in [
        BlendedFolder::cam,
        BlendedFolder::depth,
        BlendedFolder::image,
    ] {
        std::fs::copy(of(&folder, 9), of(&folder, 8))
            .map(drop)
            .unwrap();
    }
    std::fs::copy(folder.masked_image(9), folder.masked_image(8)).unwrap();
}
