//! Words of a text file with the line each stands on, for the formats that are numbers and blanks.

use crate::error::FormatError;

/// A word and its 1-based line.
#[derive(Debug, Clone, Copy)]
struct Word<'a> {
    text: &'a str,
    line: usize,
}

/// The words of a text, taken one after another. Blank lines and any amount of blanks are skipped.
pub(super) struct Words<'a> {
    rest: Box<dyn Iterator<Item = Word<'a>> + 'a>,
    next: Option<Word<'a>>,
    last_line: usize,
}

impl<'a> Words<'a> {
    /// The words of `text`; lines that start with `comment` (if any) are skipped.
    pub(super) fn new(text: &'a str, comment: Option<char>) -> Self {
        let mut rest = text
            .lines()
            .enumerate()
            .filter(move |(_, line)| {
                comment.is_none_or(|mark| !line.trim_start().starts_with(mark))
            })
            .flat_map(|(index, line)| {
                let line_number = index + 1;
                line.split_whitespace().map(move |text| Word {
                    text,
                    line: line_number,
                })
            });
        Self {
            next: rest.next(),
            rest: Box::new(rest),
            last_line: 0,
        }
    }

    /// Whether all words are taken.
    pub(super) fn is_done(&self) -> bool {
        self.next.is_none()
    }

    /// Where the next word stands, or where the text ends.
    pub(super) fn place(&self) -> String {
        match self.next {
            Some(word) => format!("line {}", word.line),
            None => format!("line {} (end of the file)", self.last_line),
        }
    }

    /// The next word, which should be `expected`.
    fn take(&mut self, expected: &str) -> Result<Word<'a>, FormatError> {
        let Some(word) = self.next else {
            let problem = format!("expected {expected}, found nothing more");
            return Err(FormatError::new(self.place(), problem));
        };
        self.last_line = word.line;
        self.next = self.rest.next();
        Ok(word)
    }

    /// Skips the word `keyword`, in any case.
    pub(super) fn keyword(&mut self, keyword: &str) -> Result<(), FormatError> {
        let word = self.take(&format!("the word `{keyword}`"))?;
        if word.text.eq_ignore_ascii_case(keyword) {
            return Ok(());
        }
        let problem = format!(
            "expected the word `{keyword}`, found `{}`",
            shown(word.text)
        );
        Err(FormatError::new(format!("line {}", word.line), problem))
    }

    /// A finite number; `what` says which.
    pub(super) fn number(&mut self, what: &str) -> Result<f64, FormatError> {
        let word = self.take(what)?;
        match word.text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(not_a(word, &format!("{what} as a finite number"))),
        }
    }

    /// A whole number; `what` says which.
    pub(super) fn integer<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, FormatError> {
        let word = self.take(what)?;
        let not_whole = |_| not_a(word, &format!("{what} as a whole number in range"));
        word.text.parse().map_err(not_whole)
    }

    /// `N` finite numbers; `what` says of which thing.
    pub(super) fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N], FormatError> {
        let mut numbers = [0.0; N];
        for (index, number) in numbers.iter_mut().enumerate() {
            *number = self.number(&format!("number {} of the {N} of {what}", index + 1))?;
        }
        Ok(numbers)
    }

    /// Nothing more; `what` says after what.
    pub(super) fn end(&self, what: &str) -> Result<(), FormatError> {
        let Some(word) = self.next else { return Ok(()) };
        let problem = format!(
            "expected the end of the file after {what}, found `{}`",
            shown(word.text)
        );
        Err(FormatError::new(self.place(), problem))
    }
}

fn not_a(word: Word<'_>, expected: &str) -> FormatError {
    let problem = format!("expected {expected}, found `{}`", shown(word.text));
    FormatError::new(format!("line {}", word.line), problem)
}

/// Foreign text cut to a length and an alphabet fit for an error message.
pub(super) fn shown(text: &str) -> String {
    let mut short: String = text.chars().take(40).flat_map(char::escape_debug).collect();
    if text.chars().nth(40).is_some() {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_know_their_line() {
        let mut words = Words::new("# head\n\n 1  2.5\r\n\tx\n", Some('#'));
        assert_eq!(words.integer::<u32>("a count").unwrap(), 1);
        assert_eq!(words.number("a size").unwrap(), 2.5);
        let error = words.number("a size").unwrap_err().to_string();
        assert_eq!(
            error,
            "line 4: expected a size as a finite number, found `x`"
        );
        let error = words.number("a size").unwrap_err().to_string();
        assert_eq!(
            error,
            "line 4 (end of the file): expected a size, found nothing more"
        );
        assert!(words.is_done() && words.end("it").is_ok());
    }

    #[test]
    fn long_and_odd_words_are_shown_short() {
        assert_eq!(shown("a\u{0}b"), "a\\0b");
        assert_eq!(shown(&"x".repeat(1000)).chars().count(), 41);
    }
}
