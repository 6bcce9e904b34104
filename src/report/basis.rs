//! What a score rests on beside its protocol: scores of one cell that rest on different truths, crops
//! or samplings of meshes are not comparable.

use super::leaderboard::{has_values, is_sound};
use super::record::Record;
use std::collections::BTreeMap;

/// What [`Basis`] lists.
const NAMES: [&str; 3] = ["truth", "crop", "mesh sampling"];
/// What the status of a record begins with that is set apart.
const NOT_COMPARABLE: &str = "not comparable: ";
/// Letters of a hash that are shown.
const SHOWN: usize = 12;

/// By [`NAMES`] what a record says of it; `None` where it says nothing. How the reconstruction was
/// aligned, and whether it is a mesh at all, is the method's own and no part of it.
struct Basis<'a>([Option<&'a str>; 3]);

impl<'a> Basis<'a> {
    fn of(record: &'a Record) -> Self {
        let said = |text: &'a str| (!text.is_empty()).then_some(text);
        let truth = said(&record.truth_sha256);
        // A record that names its truth would name its crop.
        let crop = said(&record.crop_sha256).or(truth.map(|_| "none"));
        Self([truth, crop, said(&record.mesh_sampling)])
    }
}

/// How the second record's basis differs from the first's, as far as both are known.
pub(super) fn change(before: &Record, after: &Record) -> Option<String> {
    let (before, after) = (Basis::of(before), Basis::of(after));
    let pairs = before.0.into_iter().zip(after.0);
    let changes = NAMES.into_iter().zip(pairs).filter_map(|(name, pair)| {
        let (before, after) = (pair.0?, pair.1?);
        let said = format!("{name} {} and {}", short(before), short(after));
        (before != after).then_some(said)
    });
    let changes: Vec<String> = changes.collect();
    (!changes.is_empty()).then(|| changes.join(", "))
}

/// Sets the records of one scene apart that rest on something else than most: their status says so,
/// so that they take no part in ranks and means. Where no basis is the commonest, all are.
pub(super) fn set_apart(records: &mut [&mut Record]) {
    for (nth, name) in NAMES.into_iter().enumerate() {
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for record in records.iter().filter(|r| is_sound(r) && has_values(r)) {
            if let Some(value) = Basis::of(record).0[nth] {
                *counts.entry(value.to_owned()).or_default() += 1;
            }
        }
        let most = counts.values().max().copied().unwrap_or_default();
        let mut commonest = counts.iter().filter(|(_, count)| **count == most);
        let first = commonest.next().map(|(value, _)| value);
        let kept = first.filter(|_| commonest.next().is_none());
        for record in records.iter_mut().filter(|r| is_sound(r) && has_values(r)) {
            let Some(value) = Basis::of(record).0[nth] else {
                continue;
            };
            if Some(value) == kept.map(String::as_str) {
                continue;
            }
            let whose = match kept {
                Some(kept) => format!("most have {}", short(kept)),
                None => {
                    let others = counts.keys().filter(|other| *other != value);
                    let others: Vec<&str> = others.map(|other| short(other)).collect();
                    format!("others have {}", others.join(", "))
                }
            };
            record.status = format!("{NOT_COMPARABLE}{name} {}, {whose}", short(value));
        }
    }
}

/// Whether [`set_apart`] did.
pub(super) fn is_set_apart(record: &Record) -> bool {
    record.status.starts_with(NOT_COMPARABLE)
}

fn short(value: &str) -> &str {
    value.get(..SHOWN).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The statuses of records of these truths, crops and samplings.
    fn statuses(of: &[[&str; 3]]) -> Vec<String> {
        let mut records: Vec<Record> = of
            .iter()
            .map(|[truth, crop, mesh]| Record {
                truth_sha256: (*truth).into(),
                crop_sha256: (*crop).into(),
                mesh_sampling: (*mesh).into(),
                fscore: Some(0.5),
                ..Record::default()
            })
            .collect();
        set_apart(&mut records.iter_mut().collect::<Vec<_>>());
        records.into_iter().map(|record| record.status).collect()
    }

    #[test]
    fn what_most_rest_on_counts_and_what_is_not_known_is_not_blamed() {
        let (one, two) = ("0123456789abcdef", "fedcba9876543210");
        let found = statuses(&[
            [one, "", ""],
            [two, "", ""],
            [one, "", "area"],
            ["", "", ""],
        ]);
        let said = "not comparable: truth fedcba987654, most have 0123456789ab";
        assert_eq!(found, ["", said, "", ""]);
        // The crop of another truth has no say.
        let found = statuses(&[[one, "c", ""], [one, "c", ""], [one, "", ""], [two, "", ""]]);
        assert_eq!(found[2], "not comparable: crop none, most have c");
        assert_eq!(found[..2], ["", ""]);
    }

    #[test]
    fn where_nothing_is_the_commonest_nothing_counts() {
        let found = statuses(&[["t", "", "area"], ["t", "", "vertices"], ["t", "", ""]]);
        assert_eq!(
            found,
            [
                "not comparable: mesh sampling area, others have vertices",
                "not comparable: mesh sampling vertices, others have area",
                ""
            ]
        );
    }
}
