//! The dated folders under `reports/`: each README is what its record and CSV files make.

use crate::support::{mvs_eval, stderr, text, write};
use mvs_eval::jobs::report_folder::{render, spliced};
use std::fs;
use std::path::{Path, PathBuf};

/// The folders of measurements in `root`.
fn folders(root: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(root)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut folders: Vec<PathBuf> = entries.filter(|path| path.is_dir()).collect();
    folders.sort();
    folders
}

/// What is wrong in the folders of `root`: a README that differs from what its record makes, or none.
fn differences(root: &Path) -> Vec<String> {
    let faults = folders(root).into_iter().filter_map(|folder| {
        let name = folder.display();
        match (
            render(&folder),
            fs::read_to_string(folder.join("README.md")),
        ) {
            (Err(error), _) => Some(format!("{name}: {error}")),
            (_, Err(error)) => Some(format!("{name}/README.md: {error}")),
            (Ok(made), Ok(found)) if made != found => Some(format!(
                "{name}/README.md differs from its record: run mvs-eval report --folder {name}"
            )),
            _ => None,
        }
    });
    faults.collect()
}

#[test]
fn every_readme_under_reports_is_made_from_its_record() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/reports"));
    assert!(!folders(root).is_empty());
    let faults = differences(root);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn a_changed_number_a_changed_readme_and_a_lost_file_are_found() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("2026-11-25-test");
    let record = "title = \"T\"\ndate = \"2026-11-25\"\nrevision = \"r\"\nmachine = \"m\"\n\
                  command = \"c\"\nsummary = \"s\"\nbias = \"b\"\n[versions]\nrust = \"1.95\"\n\
                  [[table]]\nfile = \"t.csv\"\ncaption = \"c\"\ndigits = { a = 1 }\n";
    write(&folder.join("run.toml"), record);
    write(&folder.join("t.csv"), "a\n0.5\n");
    let made = mvs_eval(&["report", "--folder", text(&folder)]);
    assert!(made.status.success(), "{}", stderr(&made));
    assert_eq!(differences(root.path()), Vec::<String>::new());

    write(&folder.join("t.csv"), "a\n0.75\n");
    let found = differences(root.path());
    assert!(
        found.len() == 1 && found[0].contains("differs from its record"),
        "{found:?}"
    );
    assert!(
        mvs_eval(&["report", "--folder", text(&folder)])
            .status
            .success()
    );
    assert_eq!(differences(root.path()), Vec::<String>::new());

    write(&folder.join("README.md"), "by hand\n");
    assert_eq!(differences(root.path()).len(), 1);
    let kept = mvs_eval(&["report", "--folder", text(&folder)]);
    assert_eq!(kept.status.code(), Some(2));
    assert_eq!(
        fs::read_to_string(folder.join("README.md")).unwrap(),
        "by hand\n"
    );

    fs::remove_file(folder.join("t.csv")).unwrap();
    let lost = mvs_eval(&["report", "--force", "--folder", text(&folder)]);
    assert_eq!(lost.status.code(), Some(2));
    assert!(
        stderr(&lost).contains("expected the file t.csv beside it"),
        "{}",
        stderr(&lost)
    );
}

#[test]
fn the_project_readme_shows_what_the_reports_say() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = root.join("README.md");
    let found = fs::read_to_string(&page).unwrap();
    let blocks: Vec<&str> = found
        .lines()
        .filter_map(|line| line.strip_prefix("<!-- begin "))
        .collect();
    assert!(!blocks.is_empty(), "README.md shows no report");
    for block in blocks {
        let folder = root.join(block.trim_end_matches(" -->"));
        assert_eq!(spliced(&page, &folder).unwrap(), found, "{block}");
    }
}

#[test]
fn a_splice_replaces_its_own_block_only() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("r/2026-11-25-test");
    let record = "title = \"T\"\ndate = \"2026-11-25\"\nrevision = \"r\"\nmachine = \"m\"\n\
                  command = \"c\"\nsummary = \"s\"\nbias = \"b\"\n[versions]\nrust = \"1.95\"\n\
                  [[table]]\nfile = \"t.csv\"\ncaption = \"Runs.\"\ncolumns = []\n\
                  [[table]]\nfile = \"t.csv\"\ncaption = \"Means.\"\ndigits = { a = 1 }\n\
                  [[picture]]\nfile = \"p.svg\"\ncaption = \"A picture.\"\n";
    write(&folder.join("run.toml"), record);
    write(&folder.join("t.csv"), "a\n0.55\n");
    write(&folder.join("p.svg"), "<svg/>");
    let page = root.path().join("README.md");
    write(
        &page,
        "before\n<!-- begin r/2026-11-25-test -->\nold\n<!-- end r/2026-11-25-test -->\nafter\n",
    );
    let made = mvs_eval(&["report", "--folder", text(&folder), "--into", text(&page)]);
    assert!(made.status.success(), "{}", stderr(&made));
    let expected = "before\n<!-- begin r/2026-11-25-test -->\n\n\
                    Means. ([t.csv](r/2026-11-25-test/t.csv))\n\n| a |\n| --: |\n| 0.6 |\n\n\
                    ![A picture.](r/2026-11-25-test/p.svg)\n\nA picture.\n\n\
                    <!-- end r/2026-11-25-test -->\nafter\n";
    assert_eq!(fs::read_to_string(&page).unwrap(), expected);
    assert_eq!(spliced(&page, &folder).unwrap(), expected, "twice is once");
    // However they are given.
    for (from, page, folder) in [
        ("", "README.md", "./r/2026-11-25-test"),
        ("", "README.md", text(&folder)),
        ("r", "../README.md", "2026-11-25-test/"),
        ("r/2026-11-25-test", "../../README.md", "."),
    ] {
        let said = assert_cmd::Command::new(env!("CARGO_BIN_EXE_mvs-eval"))
            .current_dir(root.path().join(from))
            .args(["report", "--folder", folder, "--into", page])
            .output()
            .unwrap();
        assert!(said.status.success(), "{from} {folder}: {}", stderr(&said));
    }
    assert_eq!(fs::read_to_string(&page).unwrap(), expected);

    write(&page, "no block\n");
    let refused = mvs_eval(&["report", "--folder", text(&folder), "--into", text(&page)]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("<!-- begin r/2026-11-25-test -->"),
        "{}",
        stderr(&refused)
    );
}
