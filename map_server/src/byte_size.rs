//! Sizes of memory as people write them.

use std::str::FromStr;

/// A number of bytes, written like 8G or 512M: with units of 1024, as operating systems count memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ByteSize(pub usize);

/// Why a text is no size.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{given:?} is no size of memory: write a number with its unit, like 8G or 512M")]
pub struct ByteSizeError {
    given: String,
}

impl FromStr for ByteSize {
    type Err = ByteSizeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refused = || ByteSizeError { given: text.to_owned() };
        let lower = text.trim().to_ascii_lowercase();
        let digits = lower.trim_end_matches(|character: char| character.is_ascii_alphabetic());
        let power = match &lower[digits.len()..] {
            "k" | "kb" | "kib" => 1,
            "m" | "mb" | "mib" => 2,
            "g" | "gb" | "gib" => 3,
            "t" | "tb" | "tib" => 4,
            _ => return Err(refused()),
        };
        let number: f64 = digits.trim().parse().map_err(|_| refused())?;
        let bytes = number * 1024_f64.powi(power);
        if bytes >= 1.0 && bytes < usize::MAX as f64 { Ok(Self(bytes as usize)) } else { Err(refused()) }
    }
}

#[cfg(test)]
mod tests {
    use super::ByteSize;

    #[test]
    fn sizes_are_read_or_refused() {
        for (text, bytes) in
            [("8G", 8 << 30), ("512M", 512 << 20), ("1.5GiB", 3 << 29), ("64 kb", 64 << 10), ("1T", 1 << 40)]
        {
            assert_eq!(text.parse(), Ok(ByteSize(bytes)), "{text}");
        }
        for wrong in ["", "8", "G", "-1G", "0M", "8X", "8Gb/s", "infG", "nanM", "1e30G"] {
            assert!(wrong.parse::<ByteSize>().is_err(), "{wrong}");
        }
    }
}
