//! A table of texts: what all table exporters share.

/// What stands in a cell whose value is missing.
pub const MISSING: &str = "–";
/// What follows a value that is shown and does not count.
pub const SUSPECT: char = '†';

/// How a cell stands out in its column.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Emphasis {
    /// Not at all.
    #[default]
    Plain,
    /// The best value: bold.
    Best,
    /// The second best value: underlined.
    Second,
}

/// A text in a table.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cell {
    /// What is shown.
    pub text: String,
    /// How.
    pub emphasis: Emphasis,
}

impl Cell {
    /// A plain cell.
    pub fn plain(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            emphasis: Emphasis::Plain,
        }
    }
}

/// A table for people. Every row has as many cells as the header.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    /// One line above the table.
    pub title: String,
    /// What sets this table apart from others, as names and values: protocol, profile, metric.
    pub identity: Vec<(String, String)>,
    /// Sentences below the table.
    pub notes: Vec<String>,
    /// Names of the columns; the first `labels` of them hold names, the others numbers.
    pub header: Vec<String>,
    /// How many columns at the left hold names.
    pub labels: usize,
    /// How many rows belong to one method.
    pub rows_per_method: usize,
    /// The rows.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// The text to show in the first column: empty where it repeats the row above in the same
    /// method.
    pub(super) fn label_of(&self, row: usize) -> &str {
        let repeats = self.rows_per_method > 1 && !row.is_multiple_of(self.rows_per_method);
        if repeats { "" } else { &self.rows[row][0].text }
    }
}

/// Which values are better.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Better {
    Higher,
    Lower,
}

/// Which values of a column stand out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Marks {
    Best,
    BestAndSecond,
}

/// Marks the best and perhaps the second best of one column; `values` belong to the rows, `None` where
/// a cell takes no part. Values that look alike are alike. Nothing is marked where several values all
/// look alike.
pub(super) fn emphasise(
    cells: &mut [&mut Cell],
    values: &[Option<f64>],
    better: Better,
    marks: Marks,
) {
    let sign = if better == Better::Higher { 1.0 } else { -1.0 };
    let mut order: Vec<usize> = (0..values.len())
        .filter(|&row| values[row].is_some())
        .collect();
    let key = |row: usize| values[row].map_or(f64::NEG_INFINITY, |value| sign * value);
    order.sort_by(|&a, &b| key(b).total_cmp(&key(a)));
    let mut texts: Vec<String> = order.iter().map(|&row| cells[row].text.clone()).collect();
    texts.dedup();
    if texts.len() == 1 && order.len() > 1 {
        return;
    }
    for row in order {
        let cell = &mut cells[row];
        if texts.first() == Some(&cell.text) {
            cell.emphasis = Emphasis::Best;
        } else if marks == Marks::BestAndSecond && texts.get(1) == Some(&cell.text) {
            cell.emphasis = Emphasis::Second;
        }
    }
}
