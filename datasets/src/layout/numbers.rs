//! View ids from the names of images.

use std::collections::BTreeSet;

/// File names have eight digits for a view's id, and readers expect no more.
const END: u32 = 100_000_000;

/// The numbers that the names are, else the names' places in name order: where a name is no number,
/// one of more than eight digits (a timestamp, say), or one twice.
pub(super) fn number_names(names: &[&str]) -> Vec<u32> {
    let short = |name: &&str| number_of(name).filter(|&number| number < END);
    let numbers: Option<Vec<u32>> = names.iter().map(short).collect();
    if let Some(numbers) = numbers
        && numbers.iter().collect::<BTreeSet<_>>().len() == names.len()
    {
        return numbers;
    }
    let mut order: Vec<usize> = (0..names.len()).collect();
    order.sort_by_key(|&index| names[index]);
    let mut ids = vec![0; names.len()];
    for (place, index) in (0u32..).zip(order) {
        ids[index] = place;
    }
    ids
}

/// 12 for `folder/00000012.jpg`.
pub(super) fn number_of(name: &str) -> Option<u32> {
    let file = name.rsplit(['/', '\\']).next()?;
    let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
    let digits = !stem.is_empty() && stem.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| stem.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_ids_as_long_as_eight_digits_hold_them() {
        assert_eq!(number_names(&["a/00000012.jpg", "7.png"]), [12, 7]);
        assert_eq!(number_names(&["99999999.jpg", "5.jpg"]), [99_999_999, 5]);
        let stamps = ["1305031102.jpg", "1305031098.jpg", "1305031100.jpg"];
        assert_eq!(number_names(&stamps), [2, 0, 1]);
        assert_eq!(number_names(&["b.jpg", "1.jpg"]), [1, 0]);
        assert_eq!(number_names(&["a/1.jpg", "b/1.jpg"]), [0, 1]);
    }
}
