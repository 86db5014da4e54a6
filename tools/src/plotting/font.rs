//! The font by which texts are measured, and which pictures in pixels are written in.
//!
//! An SVG names no font but a generic one, which the viewer chooses; its letters may be wider than ours.

use ttf_parser::Face;

/// Go Regular, by Bigelow & Holmes (BSD-3-Clause, `fonts/LICENSE`).
pub(crate) const FONT_FILE: &[u8] = include_bytes!("../../fonts/Go-Regular.ttf");
/// Its family.
#[cfg(feature = "png")]
pub(crate) const FONT_FAMILY: &str = "Go";

/// Fonts that viewers take for sans-serif are up to so much wider.
const WIDEST_VIEWER: f64 = 1.12;

/// An SVG of plotters has letters so much smaller than their size says.
const SIZE_A_PIXEL: f32 = 1.24;

/// Measures and breaks text of one size.
pub(crate) struct Letters {
    size: i32,
    font: Option<Face<'static>>,
}

impl Letters {
    /// For letters of a size, px.
    pub(crate) fn of_size(size: i32) -> Self {
        Self { size, font: Face::parse(FONT_FILE, 0).ok() }
    }

    /// Width that a text has at most, px.
    pub(crate) fn width(&self, text: &str) -> i32 {
        let pixels = self.size as f32 / SIZE_A_PIXEL;
        let advances = self.font.as_ref().map(|font| {
            let pixels_per_unit = pixels / f32::from(font.units_per_em());
            let advance = |letter: char| {
                let glyph = font.glyph_index(letter)?;
                font.glyph_hor_advance(glyph).map(|advance| f32::from(advance) * pixels_per_unit)
            };
            text.chars().map(|letter| f64::from(advance(letter).unwrap_or(pixels))).sum::<f64>()
        });
        let width = advances.unwrap_or_else(|| text.chars().count() as f64 * f64::from(self.size));
        (width * WIDEST_VIEWER).ceil() as i32
    }

    /// Breaks a text at spaces into lines of at most a width; a single longer word stays whole.
    pub(crate) fn lines(&self, text: &str, width: i32) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        for word in text.split_whitespace() {
            let longer = lines.last().map(|line| format!("{line} {word}"));
            match longer.filter(|longer| self.width(longer) <= width) {
                Some(longer) => {
                    lines.pop();
                    lines.push(longer);
                }
                None => lines.push(word.to_owned()),
            }
        }
        lines
    }

    /// A text that fits into a width: cut at the end where it must be.
    pub(crate) fn cut(&self, text: &str, width: i32) -> String {
        if self.width(text) <= width {
            return text.to_owned();
        }
        let mut kept: Vec<char> = text.chars().collect();
        while kept.pop().is_some() {
            let shorter = format!("{}\u{2026}", kept.iter().collect::<String>().trim_end());
            if self.width(&shorter) <= width {
                return shorter;
            }
        }
        String::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_letters_are_wider_and_sizes_scale() {
        let letters = Letters::of_size(20);
        assert!(letters.width("WWWW") > 2 * letters.width("iiii"));
        let (small, large) =
            (Letters::of_size(10).width("keyframes"), Letters::of_size(40).width("keyframes"));
        assert!((4 * small - large).abs() <= 4, "{small} {large}");
        assert_eq!(letters.width(""), 0);
        assert!(letters.width("\u{10ffff}") > 0, "letters that the font does not have take room, too");
    }

    #[test]
    fn lines_hold_all_words_and_fit() {
        let letters = Letters::of_size(14);
        let text = "The map is stored as it was surveyed, and half of the drive has no matches.";
        for width in [30, 100, 300, 10_000] {
            let lines = letters.lines(text, width);
            assert_eq!(lines.join(" "), text);
            assert!(lines.iter().all(|line| letters.width(line) <= width || !line.contains(' ')));
        }
        assert_eq!(letters.lines(text, 10_000).len(), 1);
        assert!(letters.lines("  ", 100).is_empty());
    }

    #[test]
    fn a_cut_text_fits_and_says_that_it_is_cut() {
        let letters = Letters::of_size(14);
        assert_eq!(letters.cut("short", 500), "short");
        let cut = letters.cut("a title that is much too long", 90);
        assert!(
            cut.ends_with('\u{2026}') && letters.width(&cut) <= 90 && cut.starts_with("a title"),
            "{cut}"
        );
        assert_eq!(letters.cut("x", 1), "");
    }
}
