//! Leaderboards, curves and pages made of records whose contents are known.

use crate::support::{mvs_eval, stderr, text as arg};
use glam::DVec3;
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::synthetic::{DepthNoise, SyntheticOptions, SyntheticScene};
use mvs_eval::report::contact_sheet::{self, SheetRow};
use mvs_eval::report::curve_svg::{self, Curves};
use mvs_eval::report::histogram_svg;
use mvs_eval::report::html::{self, ErrorCloud, PackedCloud, Page, Picture, Plot};
use mvs_eval::report::leaderboard::{Metric, boards, paper_tables, site_tables};
use mvs_eval::report::record::Record;
use mvs_eval::report::{table_csv, table_md, table_tex};
use std::io::Write;
use std::path::{Path, PathBuf};

const SCENES: [&str; 7] = [
    "Barn",
    "Caterpillar",
    "Church",
    "Courthouse",
    "Ignatius",
    "Meetingroom",
    "Truck",
];

/// The F-scores of the BlendedMVS paper: R-MVSNet by training set.
const PAPER: [(&str, [f64; 7]); 4] = [
    ("DTU", [0.492, 0.430, 0.384, 0.517, 0.553, 0.276, 0.673]),
    ("ETH3D", [0.420, 0.399, 0.306, 0.439, 0.488, 0.166, 0.580]),
    (
        "MegaDepth",
        [0.513, 0.415, 0.376, 0.553, 0.552, 0.223, 0.636],
    ),
    (
        "BlendedMVS",
        [0.539, 0.484, 0.461, 0.577, 0.636, 0.321, 0.703],
    ),
];

fn record(method: &str, scene: &str, f: f64) -> Record {
    Record {
        protocol: "tnt".into(),
        profile: "official".into(),
        split: "training".into(),
        method: method.into(),
        scene: scene.into(),
        threshold: Some(0.01),
        unit: "m".into(),
        fscore: Some(f),
        ..Record::default()
    }
}

fn paper_records() -> Vec<Record> {
    let mut records = Vec::new();
    for (trained_on, values) in PAPER {
        for (scene, f) in SCENES.into_iter().zip(values) {
            records.push(Record {
                group: trained_on.into(),
                ..record("R-MVSNet", scene, f)
            });
        }
    }
    records
}

fn text(write: impl FnOnce(&mut Vec<u8>) -> std::io::Result<()>) -> String {
    let mut bytes = Vec::new();
    write(&mut bytes).unwrap();
    String::from_utf8(bytes).unwrap()
}

#[test]
fn paper_table_has_the_papers_f_scores_and_averages() {
    let tables = paper_tables(&boards(&paper_records()).unwrap());
    let expected = "\
protocol,profile,split,threshold,method,metric,Barn,Caterpillar,Church,Courthouse,Ignatius,Meetingroom,Truck,Average
tnt,official,training,,R-MVSNet (BlendedMVS),F-score,0.539,0.484,0.461,0.577,0.636,0.321,0.703,0.532
tnt,official,training,,R-MVSNet (DTU),F-score,0.492,0.430,0.384,0.517,0.553,0.276,0.673,0.475
tnt,official,training,,R-MVSNet (ETH3D),F-score,0.420,0.399,0.306,0.439,0.488,0.166,0.580,0.400
tnt,official,training,,R-MVSNet (MegaDepth),F-score,0.513,0.415,0.376,0.553,0.552,0.223,0.636,0.467
";
    assert_eq!(text(|out| table_csv::write(out, &tables)), expected);
}

/// The F-scores of the transcribed table, cell by cell: through records and back, in CSV and LaTeX.
#[test]
fn the_transcribed_table_is_reproduced_cell_for_cell() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/datasets/manifests/blendedmvs-paper.csv"
    );
    let manifest = std::fs::read_to_string(path).unwrap();
    let rows: Vec<Vec<&str>> = manifest
        .lines()
        .filter(|line| line.contains(",F-score,"))
        .map(|line| line.split(',').collect())
        .collect();
    assert_eq!(rows.len(), 4);
    let mut records = Vec::new();
    for row in &rows {
        for (scene, cell) in SCENES.iter().zip(&row[2..9]) {
            records.push(record(row[0], scene, cell.parse().unwrap()));
        }
    }
    let tables = paper_tables(&boards(&records).unwrap());
    let csv = text(|out| table_csv::write(out, &tables));
    let latex = text(|out| table_tex::write(out, &tables));
    for row in &rows {
        let line = csv
            .lines()
            .find(|line| line.contains(&format!(",{},F-score,", row[0])))
            .unwrap();
        assert!(
            line.ends_with(&format!(",{}", row[2..].join(","))),
            "{line}"
        );
        let cells: Vec<String> = row[2..]
            .iter()
            .map(|cell| match row[0] {
                "BlendedMVS" => format!("\\textbf{{{cell}}}"), // the best of every column
                _ => (*cell).to_owned(),
            })
            .collect();
        let expected = format!("{} & F-score & {} \\\\", row[0], cells.join(" & "));
        assert!(
            latex.lines().any(|line| line == expected),
            "{expected}\n{latex}"
        );
    }
}

/// Two methods whose precision and recall are known.
fn duel() -> Vec<Record> {
    let with = |method: &str, scene: &str, precision: f64, recall: f64| Record {
        precision: Some(precision),
        recall: Some(recall),
        ..record(
            method,
            scene,
            2.0 * precision * recall / (precision + recall),
        )
    };
    vec![
        with("a_1", "Barn", 0.5, 0.25),
        with("a_1", "Truck", 0.8, 0.8),
        with("b", "Barn", 0.75, 0.25),
        with("b", "Truck", 0.8, 0.4),
    ]
}

#[test]
fn paper_table_in_latex() {
    let tables = paper_tables(&boards(&duel()).unwrap());
    let expected = r"% needs \usepackage{booktabs}
% Precision, recall and F-score · tnt · official · training
% Threshold: 0.01 m.
\begin{tabular}{llrrr}
\toprule
method & metric & Barn & Truck & Average \\
\midrule
a\_1 & precision & 0.500 & 0.800 & 0.650 \\
 & recall & 0.250 & 0.800 & 0.525 \\
 & F-score & 0.333 & \textbf{0.800} & \textbf{0.567} \\
\midrule
b & precision & 0.750 & 0.800 & 0.775 \\
 & recall & 0.250 & 0.400 & 0.325 \\
 & F-score & \textbf{0.375} & 0.533 & 0.454 \\
\bottomrule
\end{tabular}
";
    assert_eq!(text(|out| table_tex::write(out, &tables)), expected);
}

#[test]
fn site_table_in_markdown() {
    let mut records = paper_records();
    records.retain(|record| record.scene != "Truck" || record.group != "ETH3D");
    let tables = site_tables(&boards(&records).unwrap());
    let expected = "\
## F-score · tnt · official · training

| method | rank | mean rank | mean | Barn | Caterpillar | Church | Courthouse | Ignatius | Meetingroom | Truck |
| :-- | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: |
| R-MVSNet (BlendedMVS) | 1 | 1.00 | **53.16** | **53.90** | **48.40** | **46.10** | **57.70** | **63.60** | **32.10** | **70.30** |
| R-MVSNet (DTU) | 2 | 2.29 | <u>47.50</u> | 49.20 | <u>43.00</u> | <u>38.40</u> | 51.70 | <u>55.30</u> | <u>27.60</u> | <u>67.30</u> |
| R-MVSNet (MegaDepth) | 3 | 2.71 | 46.69 | <u>51.30</u> | 41.50 | 37.60 | <u>55.30</u> | 55.20 | 22.30 | 63.60 |
| R-MVSNet (ETH3D) | – | – | – | 42.00 | 39.90 | 30.60 | 43.90 | 48.80 | 16.60 | – |

Threshold: 0.01 m.

R-MVSNet (ETH3D) has no record for Truck: no mean, no rank.
";
    assert_eq!(text(|out| table_md::write(out, &tables)), expected);
}

#[test]
fn what_cannot_be_compared_stands_in_tables_of_its_own() {
    let mut records = duel();
    records.push(Record {
        profile: "strict".into(),
        ..record("c", "Barn", 0.9)
    });
    records.push(Record {
        protocol: "dtu".into(),
        fscore: None,
        overall: Some(0.3),
        ..record("d", "scan1", 0.0)
    });
    let boards_of = |records: &[Record]| boards(records).unwrap();
    let all = boards_of(&records);
    assert_eq!(all.len(), 3);
    let entries: Vec<usize> = all.iter().map(|board| board.entries.len()).collect();
    assert_eq!(entries, [1, 2, 1], "dtu, official, strict");
    assert!(all[0].has(Metric::Overall) && !all[0].has(Metric::FScore));

    records.push(Record {
        threshold: Some(0.02),
        ..record("b", "Barn", 0.5)
    });
    let thresholds: Vec<String> = boards_of(&records)
        .into_iter()
        .map(|board| board.common.threshold)
        .collect();
    assert_eq!(
        thresholds,
        ["", "", "0.02", ""],
        "dtu, official, Barn at 2 cm, strict"
    );
}

#[test]
fn equal_values_share_a_rank_and_distances_rank_the_other_way() {
    let at = |method: &str, distance: f64| Record {
        fscore: None,
        overall: Some(distance),
        ..record(method, "scan1", 0.0)
    };
    let board = &boards(&[at("far", 3.0), at("b", 1.0), at("a", 1.0)]).unwrap()[0];
    let ranking = board.ranking(Metric::Overall);
    let ranks: Vec<(&str, Option<usize>)> = ranking
        .iter()
        .map(|row| (row.label.as_str(), row.rank))
        .collect();
    assert_eq!(ranks, [("a", Some(1)), ("b", Some(1)), ("far", Some(3))]);
}

/// Puts a record into `name` under `folder`.
fn put_record(folder: &Path, name: &str, record: Record) -> PathBuf {
    let path = folder.join(name);
    let write = |out: &mut _| mvs_eval::report::record::write(out, &[record]);
    write_atomically(&path, write).unwrap();
    path
}

#[cfg(unix)]
#[test]
fn linked_folders_are_searched_each_once_and_circles_end() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    put_record(folder.path(), "in/a/scores.csv", record("a", "Barn", 0.5));
    put_record(
        folder.path(),
        "elsewhere/scores.csv",
        record("b", "Barn", 0.6),
    );
    symlink(at("elsewhere"), at("in/b")).unwrap();
    symlink(at("elsewhere"), at("in/b_again")).unwrap();
    symlink(at("in"), at("in/a/circle")).unwrap();
    let output = mvs_eval(&["report", arg(&at("in")), "--out", arg(&at("out"))]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["records"], 2);
    assert_eq!(said["files"].as_array().unwrap().len(), 2, "{said}");
}

#[test]
fn records_of_an_unfinished_result_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    put_record(folder.path(), "in/a/scores.csv", record("a", "Barn", 0.5));
    let report = || {
        mvs_eval(&[
            "report",
            arg(&at("in")),
            "--out",
            arg(&at("out")),
            "--force",
        ])
    };
    assert!(!stderr(&report()).contains("[unfinished]"));
    write_atomically(&at("in/a/run.partial.toml"), |out| out.write_all(b"")).unwrap();
    let compared = mvs_eval(&["compare", arg(&at("in")), arg(&at("in/a/scores.csv"))]);
    for output in [report(), compared] {
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert!(
            said.contains("[unfinished]") && said.contains("in/a/scores.csv lies"),
            "{said}"
        );
    }
}

#[test]
fn boards_of_other_units_are_named_by_them_and_pass_our_own_check() {
    let mut records = duel();
    records.extend(duel().into_iter().map(|record| Record {
        unit: "mm".into(),
        ..record
    }));
    let boards = boards(&records).unwrap();
    let tables = site_tables(&boards);
    let titles: Vec<&str> = tables.iter().map(|table| table.title.as_str()).collect();
    assert_eq!(titles[0], "F-score · tnt · official · training · m");
    assert_eq!(titles[3], "F-score · tnt · official · training · mm");
    for tables in [tables, paper_tables(&boards)] {
        let csv = text(|out| table_csv::write(out, &tables));
        let checked = mvs_eval::report::check::check(csv.as_bytes()).unwrap();
        assert!(checked.slips.is_empty() && checked.averages > 0, "{csv}");
    }
}

#[test]
fn scores_without_a_threshold_do_not_stand_beside_those_with_one() {
    let without = |method: &str, scene: &str| Record {
        threshold: None,
        ..record(method, scene, 0.9)
    };
    let failed = Record {
        fscore: None,
        status: "failed: no cameras".into(),
        ..without("failed", "Barn")
    };
    let records = [record("a", "Barn", 0.5), without("b", "Barn"), failed];
    let found = boards(&records).unwrap();
    let shape = |nth: usize| {
        let labels = found[nth].entries.iter().map(|entry| entry.label.as_str());
        (
            found[nth].common.threshold.as_str(),
            labels.collect::<Vec<_>>(),
        )
    };
    assert_eq!(found.len(), 2);
    assert_eq!(shape(0), ("", vec!["a", "failed"]));
    assert_eq!(shape(1), ("none", vec!["b"]));
    assert!(
        site_tables(&found)[1]
            .title
            .ends_with(" · no threshold given")
    );
    // Where no score of a scene names one, nothing is told apart.
    let one = boards(&[
        record("a", "Barn", 0.5),
        without("a", "Truck"),
        without("b", "Truck"),
    ])
    .unwrap();
    assert_eq!(one.len(), 1);
}

#[test]
fn scenes_with_the_names_of_other_columns_stand_in_columns_of_their_own() {
    let scenes = [
        "Barn", "Rank", "average", "mean", "method", "metric", "profile",
    ];
    let values = (0..).map(|nth| f64::from(nth) / 16.0);
    let records: Vec<Record> = scenes
        .into_iter()
        .zip(values)
        .map(|(scene, f)| record("a", scene, f))
        .collect();
    let boards = boards(&records).unwrap();
    let site = text(|out| table_csv::write(out, &site_tables(&boards)));
    let expected = "\
protocol,profile,split,threshold,metric,method,rank,mean rank,mean,Barn,scene Rank,scene average,scene mean,\
scene method,scene metric,scene profile
tnt,official,training,,F-score,a,1,1.00,18.75,0.00,6.25,12.50,18.75,25.00,31.25,37.50
";
    assert_eq!(site, expected);
    let paper = text(|out| table_csv::write(out, &paper_tables(&boards)));
    for csv in [site, paper] {
        let checked = mvs_eval::report::check::check(csv.as_bytes()).unwrap();
        assert_eq!((checked.averages, checked.slips.len()), (1, 0), "{csv}");
    }
}

#[test]
fn two_methods_with_one_label_are_refused() {
    let grouped = Record {
        group: "d".into(),
        ..record("X", "Truck", 0.6)
    };
    let alike = [record("X (d)", "Barn", 0.5), grouped];
    let error = boards(&alike).unwrap_err().to_string();
    assert!(
        error.contains("found two that look like X (d): "),
        "{error}"
    );
}

#[test]
fn another_truth_is_shown_and_takes_no_part_in_ranks() {
    let of = |method: &str, truth: &str, f: f64| Record {
        truth_sha256: truth.into(),
        ..record(method, "Barn", f)
    };
    let records = [of("a", "t1", 0.5), of("b", "t2", 0.9), of("c", "t1", 0.6)];
    let boards = boards(&records).unwrap();
    let ranking = boards[0].ranking(Metric::FScore);
    let ranks: Vec<(&str, Option<usize>)> = ranking
        .iter()
        .map(|row| (row.label.as_str(), row.rank))
        .collect();
    assert_eq!(ranks, [("c", Some(1)), ("a", Some(2)), ("b", None)]);
    let tables = site_tables(&boards);
    let said = "† b, Barn: not comparable: truth t2, most have t1; no mean, no rank.";
    assert!(
        tables[0].notes.iter().any(|note| note == said),
        "{:?}",
        tables[0].notes
    );
    let warned = boards[0].not_comparable();
    assert_eq!(warned.len(), 1);
    assert!(
        warned[0].starts_with("scores of Barn are ") && warned[0].contains(": b "),
        "{warned:?}"
    );
}

#[test]
fn two_records_for_one_cell_are_refused() {
    let error = boards(&[record("a", "Barn", 0.5), record("a", "Barn", 0.6)])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("found two for a on Barn at threshold 0.01"),
        "{error}"
    );
    let nan = boards(&[record("a", "Barn", f64::NAN)])
        .unwrap_err()
        .to_string();
    assert!(
        nan.contains("F-score of a on Barn: expected a number"),
        "{nan}"
    );
}

#[test]
fn records_for_one_cell_name_their_files_and_a_bad_picture_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for (name, fscore) in [("one", 0.5), ("two", 0.6)] {
        let records = [record("a", "Barn", fscore)];
        let path = at(name).join("scores.csv");
        write_atomically(&path, |out| mvs_eval::report::record::write(out, &records)).unwrap();
    }
    let (one, two, out) = (at("one"), at("two"), at("out"));
    let output = mvs_eval(&["report", arg(&one), arg(&two), "--out", arg(&out)]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for part in [
        "one/scores.csv and ",
        "two/scores.csv: ",
        "two for a on Barn at threshold 0.01",
    ] {
        assert!(said.contains(part), "{said}");
    }
    let picture = at("picture.png");
    write_atomically(&picture, |out| out.write_all(b"no picture")).unwrap();
    let arguments = [
        "report",
        arg(&one),
        "--picture",
        arg(&picture),
        "--out",
        arg(&out),
    ];
    let output = mvs_eval(&arguments);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(!out.join("leaderboard.csv").exists() && !out.join("results.csv").exists());
    let output = mvs_eval(&["report", arg(&one), "--into", "README.md"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}

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
        eprintln!("skipped: no chromium on PATH, and MVS_EVAL_CHROMIUM names no browser");
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
