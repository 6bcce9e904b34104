//! Leaderboards, curves and pages made of records whose contents are known.

mod page;
mod records;
mod said;

use mvs_eval::report::leaderboard::{Metric, boards, paper_tables, site_tables};
use mvs_eval::report::record::Record;
use mvs_eval::report::{table_csv, table_md, table_tex};

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
