//! MVSNet / BlendedMVS `pair.txt`: source views per reference view.

use super::text::Words;
use crate::error::FormatError;
use crate::scene::SourceScore;
use std::collections::BTreeSet;
use std::io::Write;

/// One reference view's id and its source views, in the order of the file (best first by convention).
#[derive(Debug, Clone, PartialEq)]
pub struct PairEntry {
    /// The reference view's id.
    pub id: u32,
    /// Its source views.
    pub sources: Vec<SourceScore>,
}

/// Reads a `pair.txt`: the count of views, then per view its id and `n id score id score …`. Ids
/// are distinct, scores finite and ≥ 0. Whether the views exist is for the caller to check.
///
/// # Errors
/// A number that is missing or none, an id of an entry twice, a score below 0 or not finite, and text after the last
/// entry that is promised.
pub fn read(text: &str) -> Result<Vec<PairEntry>, FormatError> {
    let mut words = Words::new(text, None);
    let count: usize = words.integer("the count of views")?;
    let mut seen = BTreeSet::new();
    let mut entries = Vec::new();
    while entries.len() < count {
        let place = words.place();
        let id = words.integer(&format!("the id of entry {} of {count}", entries.len()))?;
        if !seen.insert(id) {
            let problem = format!("expected distinct view ids, found {id} twice");
            return Err(FormatError::new(place, problem));
        }
        entries.push(PairEntry {
            id,
            sources: read_sources(&mut words, id)?,
        });
    }
    words.end(&format!("the {count} entries that the first line promises"))?;
    Ok(entries)
}

fn read_sources(words: &mut Words<'_>, reference: u32) -> Result<Vec<SourceScore>, FormatError> {
    let count: usize = words.integer(&format!("the count of sources of view {reference}"))?;
    let mut sources = Vec::new();
    for nth in 1..=count {
        let what = format!("source {nth} of the {count} of view {reference}");
        let id = words.integer(&format!("the id of {what}"))?;
        let place = words.place();
        let score = words.number(&format!("the score of {what}"))?;
        if score < 0.0 {
            let problem = format!("expected a score of at least 0, found {score}");
            return Err(FormatError::new(place, problem));
        }
        sources.push(SourceScore { id, score });
    }
    Ok(sources)
}

/// Writes a `pair.txt` without trailing blanks, scores with the shortest digits that read back.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, pairs: &[PairEntry]) -> std::io::Result<()> {
    writeln!(out, "{}", pairs.len())?;
    for entry in pairs {
        write!(out, "{}\n{}", entry.id, entry.sources.len())?;
        for source in &entry.sources {
            write!(out, " {} {}", source.id, source.score)?;
        }
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sources() -> impl Strategy<Value = Vec<SourceScore>> {
        let source = (any::<u32>(), 0.0..1e300).prop_map(|(id, score)| SourceScore { id, score });
        proptest::collection::vec(source, 0..6)
    }

    proptest! {
        #[test]
        fn every_list_reads_back(
            lists in proptest::collection::btree_map(any::<u32>(), sources(), 0..5),
        ) {
            let pairs: Vec<PairEntry> =
                lists.into_iter().map(|(id, sources)| PairEntry { id, sources }).collect();
            let mut text = Vec::new();
            write(&mut text, &pairs).unwrap();
            let text = String::from_utf8(text).unwrap();
            prop_assert!(text.lines().all(|line| line.trim_end() == line));
            prop_assert_eq!(read(&text).unwrap(), pairs);
        }
    }

    #[test]
    fn a_real_file_reads_to_its_numbers() {
        let text = "2\n0\n2 31 273.3005 29 159.4776 \n1\n0\n";
        let pairs = read(text).unwrap();
        assert_eq!((pairs[0].id, pairs[1].id), (0, 1));
        assert_eq!(
            pairs[0].sources[1],
            SourceScore {
                id: 29,
                score: 159.4776
            }
        );
        assert!(pairs[1].sources.is_empty());
    }

    #[test]
    fn broken_lists_are_said_with_their_line() {
        for (text, expected) in [
            ("", "expected the count of views, found nothing more"),
            ("x", "line 1: expected the count of views as a whole number"),
            (
                "4000000000\n0\n0\n",
                "expected the id of entry 1 of 4000000000",
            ),
            (
                "1\n0\n4000000000 1 2.0",
                "expected the id of source 2 of the 4000000000 of view 0",
            ),
            ("1\n0\n1 1 nan", "line 3: expected the score of source 1"),
            (
                "1\n0\n1 1 -2",
                "line 3: expected a score of at least 0, found -2",
            ),
            (
                "2\n0\n0\n0\n0",
                "line 4: expected distinct view ids, found 0 twice",
            ),
            ("1\n0\n0\n7", "line 4: expected the end of the file"),
            ("1\n-1\n0", "line 2: expected the id of entry 0"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
