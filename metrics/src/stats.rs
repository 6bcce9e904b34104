//! Mean and median that do not depend on threads.

/// Values added up in one block before the blocks are added up, in order.
const BLOCK: usize = 4096;

/// The sum, in fixed blocks: the same bits whoever computes the blocks.
pub fn sum(values: &[f64]) -> f64 {
    values
        .chunks(BLOCK)
        .map(|block| block.iter().sum::<f64>())
        .sum()
}

/// The arithmetic mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| sum(values) / values.len() as f64)
}

/// The median, the mean of the two middle values of an even number; `None` of nothing.
/// NaN sorts above infinity.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    if !even {
        return Some(upper);
    }
    let lower = below.iter().copied().max_by(f64::total_cmp)?;
    Some((lower + upper) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_forms() {
        let values: Vec<f64> = (0..10_001).rev().map(f64::from).collect();
        assert_eq!(mean(&values), Some(5000.0));
        assert_eq!(median(&values), Some(5000.0));
        assert_eq!(median(&values[..4]), Some(9998.5));
        assert_eq!((mean(&[]), median(&[])), (None, None));
    }
}
