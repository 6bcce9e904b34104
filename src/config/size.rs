use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// An image size, written `2048x1536`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Size {
    /// Width in pixels, ≥ 1.
    pub width: u32,
    /// Height in pixels, ≥ 1.
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = |part: &str| part.trim().parse().ok().filter(|&pixels: &u32| pixels > 0);
        let size = text
            .split_once(['x', 'X', '×'])
            .and_then(|(width, height)| {
                Some(Self {
                    width: parse(width)?,
                    height: parse(height)?,
                })
            });
        size.ok_or_else(|| format!("expected a size as WIDTHxHEIGHT, found `{text}`"))
    }
}

impl TryFrom<String> for Size {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Size> for String {
    fn from(size: Size) -> Self {
        size.to_string()
    }
}

impl fmt::Display for Size {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}x{}", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_read_back_and_nonsense_is_refused() {
        let size: Size = "2048x1536".parse().unwrap();
        assert_eq!(
            (size.width, size.height, size.to_string().as_str()),
            (2048, 1536, "2048x1536")
        );
        for text in ["", "12", "0x5", "4x-3", "axb", "1x2x3"] {
            assert!(
                text.parse::<Size>().unwrap_err().contains("WIDTHxHEIGHT"),
                "{text}"
            );
        }
    }
}
