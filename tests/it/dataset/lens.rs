//! Photographs taken through a lens.

use super::*;

/// What a camera behind a lens takes of a large picture that the pinhole camera would take.
fn bent_photograph(large: &ColorImage, pinhole: &View, bent: &View) -> ColorImage {
    let (width, height) = (bent.camera.width(), bent.camera.height());
    let scale = f64::from(large.width()) / f64::from(width);
    let mut photograph = ColorImage::filled(width, height, [0; 3]).unwrap();
    for row in 0..height {
        for column in 0..width {
            let centre = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let ray = bent.camera.ray(centre);
            let at = scale * pinhole.camera.project(ray).unwrap();
            // The mean of a pixel's worth of the large picture.
            let reach = 0.5 * scale;
            let span = |at: f64, length: u32| {
                let first = (at - reach).round().clamp(0.0, f64::from(length - 1)) as u32;
                let end = (at + reach).round().clamp(0.0, f64::from(length)) as u32;
                first..end.max(first + 1)
            };
            let mut sums = [0u32; 4];
            for y in span(at.y, large.height()) {
                for x in span(at.x, large.width()) {
                    let pixel = large.get(x, y).map(u32::from);
                    for (sum, value) in sums.iter_mut().zip([pixel[0], pixel[1], pixel[2], 1]) {
                        *sum += value;
                    }
                }
            }
            let mean = [0, 1, 2].map(|channel| (sums[channel] / sums[3]) as u8);
            photograph.set(column, row, mean);
        }
    }
    photograph
}

/// The photographs' lens is undone: the data set's cameras are pinhole ones, and what is blended is
/// what a pinhole camera would have taken. The lens is strong enough that leaving it, or doing it once
/// more, would show. Compared is luminance, which the JPEG keeps at full resolution.
#[test]
fn photographs_through_a_lens_are_undistorted() {
    let folder = tempfile::tempdir().unwrap();
    let lens = |sign: f64| Distortion::RadialTangential {
        radial: [-0.35 * sign, 0.1, 0.0, 0.0, 0.0, 0.0],
        tangential: [3e-3 * sign, 0.0],
    };
    let truth = synthetic();
    let renderer = Renderer::new(truth.mesh()).unwrap();
    let through = |lens: Distortion| {
        let bend = |view: &View| View {
            camera: view.camera.with_distortion(lens).unwrap(),
            ..view.clone()
        };
        Scene::new(truth.scene().views().iter().map(bend).collect()).unwrap()
    };
    let bent = through(lens(1.0));
    let photos = folder.path().join("photos");
    let mut straight = Vec::new();
    for (view, bent) in truth.scene().views().iter().zip(bent.views()) {
        let render = |view: &View| renderer.render(view, &RenderOptions::default()).unwrap();
        let large = render(&View {
            camera: view.camera.resized(8 * 128, 8 * 96).unwrap(),
            ..view.clone()
        });
        straight.push(render(view).color);
        let photograph = bent_photograph(&large.color, view, bent);
        let path = photos.join(mvsnet::file_name(view.id, ".png"));
        files::write_atomically(&path, |out| image::write_png(out, &photograph)).unwrap();
    }
    // With the cameras as they are, with their lenses forgotten, and with them the wrong way around.
    let mut off = Vec::new();
    for (name, cameras) in [
        ("undone", &bent),
        ("left", truth.scene()),
        ("doubled", &through(lens(-1.0))),
    ] {
        let (model, out) = (folder.path().join(name), format!("{name}-set"));
        exports::write_colmap(&model, cameras).unwrap();
        let more = ["--cameras", text(&model), "--photos", text(&photos)];
        let extras = ["--extras", "input-images", "--out", &out];
        succeed(folder.path(), &[more, extras].concat());
        let scene = scene_of(&folder.path().join(&out));
        let views = scene.read_scene(None).unwrap();
        for (cam, view) in views.views().iter().zip(truth.scene().views()) {
            assert_eq!(cam.camera, view.camera);
        }
        let differences = views.views().iter().zip(&straight).map(|(view, straight)| {
            let used = files::read_image(&scene.input_image(view.id)).unwrap();
            luminance_difference(&used, straight)
        });
        off.push(differences.fold(0.0, f64::max));
    }
    let [undone, left, doubled] = off[..] else {
        panic!("three ways");
    };
    assert!(undone < 2.0, "{undone} grey levels");
    assert!(
        left > 2.0 * undone && doubled > 3.0 * undone,
        "{undone} {left} {doubled}"
    );
}

/// The mean absolute difference in grey levels.
fn luminance_difference(a: &ColorImage, b: &ColorImage) -> f64 {
    let luminance =
        |[r, g, b]: [u8; 3]| 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
    let pairs = a.values().iter().zip(b.values());
    let sum: f64 = pairs
        .map(|(&a, &b)| (luminance(a) - luminance(b)).abs())
        .sum();
    sum / a.values().len() as f64
}
