//! The page: what it is made of, and in a browser.

use super::*;
use crate::support::{mvs_eval, say_skipped, stderr, text as arg};
use glam::DVec3;
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::synthetic::{DepthNoise, SyntheticOptions, SyntheticScene};
use mvs_eval::report::contact_sheet::{self, SheetRow};
use mvs_eval::report::curve_svg::{self, Curves};
use mvs_eval::report::histogram_svg;
use mvs_eval::report::html::{self, ErrorCloud, PackedCloud, Page, Picture, Plot};
use std::io::Write;
use std::path::{Path, PathBuf};

/// A page with everything on it, made of a synthetic scene whose sampled surface is moved by known
/// amounts.
fn page() -> String {
    let scene = SyntheticScene::new(SyntheticOptions::default()).unwrap();
    let surface = scene.sample_surface(0.008).unwrap();
    let tau = 0.01;
    // Off by up to 3 τ where the surface is high, in waves.
    let moved: Vec<DVec3> = surface
        .positions()
        .iter()
        .zip(surface.normals().unwrap())
        .map(|(&point, normal)| {
            let wave = 0.5 + 0.5 * (9.0 * point.x).sin() * (9.0 * point.y).cos();
            point + normal.as_dvec3() * (3.0 * tau * wave * (0.2 + point.z).min(1.0))
        })
        .collect();
    let distances: Vec<f64> = moved
        .iter()
        .map(|&point| scene.distance_to_surface(point))
        .collect();
    let edges: Vec<f64> = (1..500).map(|step| f64::from(step) * tau / 100.0).collect();
    let below =
        |edge: f64| distances.iter().filter(|&&d| d < edge).count() as f64 / distances.len() as f64;
    let precision: Vec<f64> = edges.iter().map(|&edge| below(edge)).collect();
    let recall: Vec<f64> = edges.iter().map(|&edge| below(0.8 * edge)).collect();
    let curves = Curves {
        title: "tabletop",
        tau,
        at_tau: (below(tau), below(0.8 * tau)),
        unit: "m",
        distances: &edges,
        precision: &precision,
        recall: &recall,
    };
    let depths: Vec<_> = (0..4)
        .map(|view| contact_sheet::depth_image(&scene.depth(view)))
        .collect();
    let noisy: Vec<_> = (0..4)
        .map(|view| {
            contact_sheet::depth_image(&scene.estimated_depth(view, &DepthNoise::default()).0)
        })
        .collect();
    let rows: Vec<SheetRow> = (0..4)
        .map(|view| SheetRow {
            label: format!("view {view}"),
            images: vec![Some(&depths[view]), Some(&noisy[view])],
        })
        .collect();
    let sheet = contact_sheet::draw(&["exact depth", "estimated depth"], &rows, 320).unwrap();
    let mut png = Vec::new();
    mvs_datasets::format::image::write_png(&mut png, &sheet).unwrap();
    let boards = boards(&paper_records()).unwrap();
    let mut tables = site_tables(&boards);
    tables.extend(paper_tables(&boards));
    let cloud = ErrorCloud {
        name: "tabletop, precision",
        positions: &moved,
        distances: &distances,
        tau,
        unit: "m",
    };
    html::html(&Page {
        title: "Report <of a test>",
        lead: "R-MVSNet by training set, and a synthetic scene whose errors are known.",
        tables: &tables,
        plots: &[
            Plot {
                caption: "Precision, recall and F-score of tabletop".into(),
                svg: curve_svg::svg(&curves).unwrap(),
            },
            Plot {
                caption: "Errors of tabletop".into(),
                svg: histogram_svg::svg("tabletop, precision", &distances, tau, "m").unwrap(),
            },
        ],
        clouds: &[PackedCloud::new(&cloud, 1).unwrap()],
        still: None,
        pictures: &[Picture {
            caption: "Depth of four views".into(),
            media_type: "image/png",
            bytes: png,
        }],
        provenance: &[
            (
                "command".into(),
                "mvs-eval report results.csv --out report".into(),
            ),
            ("seed".into(), "0".into()),
        ],
    })
    .unwrap()
}

/// The browser that `MVS_EVAL_CHROMIUM` names, or a Chromium on the PATH.
fn browser() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("MVS_EVAL_CHROMIUM") {
        return Some(named.into());
    }
    let folders = std::env::var_os("PATH")?;
    std::env::split_paths(&folders)
        .flat_map(|folder| ["chromium", "chromium-browser"].map(|name| folder.join(name)))
        .find(|path| path.is_file())
}

/// Opens a page in headless Chromium: the document after its scripts
/// have run, and what they wrote to the console. `None` where there is no browser.
fn opened(name: &str, page: &str) -> Option<(String, String)> {
    let Some(chromium) = browser() else {
        say_skipped("no chromium on PATH, and MVS_EVAL_CHROMIUM names no browser");
        return None;
    };
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    write_atomically(&path, |out| out.write_all(page.as_bytes())).unwrap();
    let output = std::process::Command::new(chromium)
        .args([
            "--headless=new",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
        ])
        .args([
            "--virtual-time-budget=20000",
            "--enable-logging=stderr",
            "--dump-dom",
        ])
        .arg(format!("file://{}", path.display()))
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Some((text(&output.stdout), text(&output.stderr)))
}

/// `mvs-eval report` of a score folder that the command line has made, with a page that loads, draws
/// the cloud and sorts.
#[test]
fn a_score_folder_becomes_a_page_from_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let demo = mvs_eval(&[
        "demo",
        "--views",
        "6",
        "--size",
        "128x96",
        "--out",
        arg(&at("demo")),
    ]);
    assert!(demo.status.success(), "{}", stderr(&demo));
    let score = at("demo/score");
    let out = at("report");
    let made = mvs_eval(&[
        "report",
        arg(&score),
        "--title",
        "A <test>",
        "--out",
        arg(&out),
    ]);
    assert!(made.status.success(), "{}", stderr(&made));
    let document = std::fs::read_to_string(score.join("score.json")).unwrap();
    let newer = document.replace("mvs-eval score 1", "mvs-eval score 9");
    write_atomically(&at("newer/score.json"), |out| {
        out.write_all(newer.as_bytes())
    })
    .unwrap();
    std::fs::copy(score.join("scores.csv"), at("newer/scores.csv")).unwrap();
    let refused = mvs_eval(&["report", arg(&at("newer")), "--out", arg(&at("no"))]);
    assert_eq!(refused.status.code(), Some(2));
    let said = "score.json: schema: expected mvs-eval score 1, found mvs-eval score 9";
    assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    // Without its clouds a score still counts; what the page lacks is said.
    for name in ["score.json", "scores.csv"] {
        std::fs::create_dir_all(at("bare")).unwrap();
        std::fs::copy(score.join(name), at("bare").join(name)).unwrap();
    }
    let bare = mvs_eval(&["report", arg(&at("bare")), "--out", arg(&at("of bare"))]);
    assert_eq!(bare.status.code(), Some(0), "{}", stderr(&bare));
    let said = "the page has no curves and clouds of a score: ";
    assert!(stderr(&bare).contains(said), "{}", stderr(&bare));
    assert!(
        stderr(&bare).contains("demo.precision.ply"),
        "{}",
        stderr(&bare)
    );
    let of_bare = std::fs::read_to_string(at("of bare/index.html")).unwrap();
    assert!(of_bare.contains("noisy-depth") && !of_bare.contains("<h2>Curves</h2>"));
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("<h1>A &lt;test&gt;</h1>") && page.contains("BLAKE3"));
    assert!(page.contains("demo, noisy-depth: precision") && page.contains("noisy-depth: recall"));
    let still = std::fs::read(out.join("errors.png")).unwrap();
    assert!(still.starts_with(b"\x89PNG"));
    let of_demo = std::fs::read_to_string(at("demo/report/index.html")).unwrap();
    assert!(of_demo.contains("contact sheet") && of_demo.len() < 10_000_000);
    let Some((document, log)) = opened("report-cli.html", &of_demo) else {
        return;
    };
    assert_eq!(attribute(&document, "data-state"), "ok", "{log}");
    let drawn: f64 = attribute(&document, "data-drawn").parse().unwrap();
    assert!((0.02..0.9).contains(&drawn), "{drawn} of the canvas");
    assert!(!log.contains("CONSOLE"), "{log}");
}

fn attribute<'a>(document: &'a str, name: &str) -> &'a str {
    let start = document
        .find(&format!("{name}=\""))
        .map(|at| at + name.len() + 2);
    start.map_or("", |start| {
        document[start..].split('"').next().unwrap_or("")
    })
}

#[test]
fn page_loads_draws_and_sorts_in_a_browser() {
    let page = page();
    assert!(page.len() < 3_000_000);
    let Some((document, log)) = opened("report.html", &page) else {
        return;
    };
    assert_eq!(attribute(&document, "data-state"), "ok", "{log}");
    let drawn: f64 = attribute(&document, "data-drawn").parse().unwrap();
    assert!((0.02..0.9).contains(&drawn), "{drawn} of the canvas");
    assert!(!log.contains("CONSOLE"), "{log}");
    let clicks = "<script>document.querySelectorAll('th button')[4].click();\
        var names = [].map.call(document.querySelectorAll('tbody')[0].rows, function (row) { return row.cells[4].textContent; });\
        document.documentElement.dataset.sorted = names.join(' ');\
        document.querySelectorAll('th button')[4].click();\
        names = [].map.call(document.querySelectorAll('tbody')[0].rows, function (row) { return row.cells[4].textContent; });\
        document.documentElement.dataset.again = names.join(' ');</script></body>";
    let (document, _) = opened("report-sorted.html", &page.replace("</body>", clicks)).unwrap();
    assert_eq!(
        attribute(&document, "data-sorted"),
        "53.90 51.30 49.20 42.00"
    );
    assert_eq!(
        attribute(&document, "data-again"),
        "42.00 49.20 51.30 53.90"
    );
}

#[test]
fn a_page_that_cannot_draw_says_so() {
    let broken = page().replace("gl_PointSize = clamp", "gl_PointSize = klamp");
    let Some((document, _)) = opened("report-broken.html", &broken) else {
        return;
    };
    assert!(
        attribute(&document, "data-state").starts_with("error: "),
        "{}",
        attribute(&document, "data-state")
    );
}

/// The page in frames as wide as a phone and a window: nothing in it but tables, which scroll, is wider.
#[test]
fn long_names_do_not_make_the_page_scroll_sideways() {
    let long = "a_method_of_a_long_name_".repeat(12);
    let mut records = duel();
    records.push(record(&long, "Barn", 0.5));
    let tables = site_tables(&boards(&records).unwrap());
    let path = format!("{long}/scores.csv");
    let page = html::html(&Page {
        title: &long,
        lead: &long,
        tables: &tables,
        provenance: &[("program".into(), "mvs-eval".into()), (path, long.clone())],
        ..Page::default()
    })
    .unwrap();
    let page = page.replace('&', "&amp;").replace('"', "&quot;");
    let frame =
        |width: u32| format!("<iframe srcdoc=\"{page}\" style=\"width:{width}px\"></iframe>");
    let frames = [390, 1000].map(frame).concat();
    let measure = "<script>onload = function () { document.documentElement.dataset.widths = \
                   [].map.call(frames, function (frame) { var root = frame.document.documentElement; \
                   return root.scrollWidth + '/' + root.clientWidth; }).join(' '); };</script>";
    let Some((document, log)) = opened("report-long.html", &format!("{frames}{measure}")) else {
        return;
    };
    let widths = attribute(&document, "data-widths");
    let fits = |pair: &str| {
        pair.split_once('/')
            .is_some_and(|(all, shown)| all == shown)
    };
    let count = widths.split(' ').filter(|pair| fits(pair)).count();
    assert_eq!(count, 2, "{widths}: {log}");
}
