//! A writer of SVG for what the plotting library cannot do: embedded images and tooltips.
//!
//! Text and attributes are escaped here and nowhere else, and every element that is opened is closed at the end.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use plotters::style::RGBColor;
use std::fmt::{Display, Write as _};
use vision::{GrayImage, ImageError};

use super::canvas::FONT;

/// An attribute of an element.
pub(super) type Attribute<'a> = (&'a str, &'a dyn Display);

/// A drawing in progress.
pub(super) struct Svg {
    text: String,
    open: Vec<&'static str>,
}

/// Where words stand about their position.
#[derive(Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

impl Svg {
    /// A white sheet.
    ///
    /// # Arguments
    /// * `size`: width and height (px).
    /// * `style`: CSS of the whole drawing, without markup.
    pub(super) fn new(size: (f64, f64), style: &str) -> Self {
        let mut svg = Self { text: String::new(), open: Vec::new() };
        let view = format!("0 0 {} {}", size.0, size.1);
        let root: [Attribute<'_>; 5] = [
            ("xmlns", &"http://www.w3.org/2000/svg"),
            ("viewBox", &view),
            ("width", &size.0),
            ("height", &size.1),
            ("font-family", &FONT),
        ];
        svg.open("svg", &root);
        svg.open("style", &[]);
        svg.push(style);
        svg.close();
        svg.element("rect", &[("width", &"100%"), ("height", &"100%"), ("fill", &"white")]);
        svg
    }

    /// Opens an element; what follows is inside until [`Svg::close`].
    pub(super) fn open(&mut self, name: &'static str, attributes: &[Attribute<'_>]) {
        self.tag(name, attributes);
        self.text.push('>');
        self.open.push(name);
    }

    /// Closes the element that was opened last.
    pub(super) fn close(&mut self) {
        if let Some(name) = self.open.pop() {
            self.text.push_str("</");
            self.text.push_str(name);
            self.text.push_str(">\n");
        }
    }

    /// An element with nothing inside.
    pub(super) fn element(&mut self, name: &'static str, attributes: &[Attribute<'_>]) {
        self.tag(name, attributes);
        self.text.push_str("/>");
    }

    /// Words that show when the pointer is over the element that is open.
    pub(super) fn hover(&mut self, words: &str) {
        self.open("title", &[]);
        self.push(words);
        self.close();
    }

    /// A line.
    pub(super) fn line(&mut self, from: (f64, f64), to: (f64, f64), more: &[Attribute<'_>]) {
        let (x1, y1, x2, y2) = (px(from.0), px(from.1), px(to.0), px(to.1));
        let ends: [Attribute<'_>; 4] = [("x1", &x1), ("y1", &y1), ("x2", &x2), ("y2", &y2)];
        self.element("line", &[&ends, more].concat());
    }

    /// A disc.
    pub(super) fn dot(&mut self, at: (f64, f64), radius: f64, more: &[Attribute<'_>]) {
        let (x, y) = (px(at.0), px(at.1));
        let place: [Attribute<'_>; 3] = [("cx", &x), ("cy", &y), ("r", &radius)];
        self.element("circle", &[&place, more].concat());
    }

    /// A rectangle from its top left corner.
    pub(super) fn rectangle(&mut self, at: (f64, f64), size: (f64, f64), more: &[Attribute<'_>]) {
        let (x, y, width, height) = (px(at.0), px(at.1), px(size.0), px(size.1));
        let place: [Attribute<'_>; 4] = [("x", &x), ("y", &y), ("width", &width), ("height", &height)];
        self.element("rect", &[&place, more].concat());
    }

    /// Words on a base line.
    pub(super) fn words(&mut self, at: (f64, f64), size: f64, anchor: Anchor, colour: RGBColor, words: &str) {
        let (x, y, colour) = (px(at.0), px(at.1), css(colour));
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let place: [Attribute<'_>; 5] =
            [("x", &x), ("y", &y), ("font-size", &size), ("text-anchor", &anchor), ("fill", &colour)];
        self.open("text", &place);
        self.push(words);
        self.close();
    }

    /// An image, inside the drawing itself.
    ///
    /// # Errors
    /// An image that PNG cannot hold.
    pub(super) fn image(
        &mut self,
        image: &GrayImage,
        at: (f64, f64),
        size: (f64, f64),
    ) -> Result<(), ImageError> {
        let (x, y, width, height) = (px(at.0), px(at.1), px(size.0), px(size.1));
        let data = format!("data:image/png;base64,{}", STANDARD.encode(image.to_png()?));
        let place: [Attribute<'_>; 6] = [
            ("class", &"photo"),
            ("x", &x),
            ("y", &y),
            ("width", &width),
            ("height", &height),
            ("href", &data),
        ];
        self.element("image", &place);
        Ok(())
    }

    /// The drawing.
    pub(super) fn finish(mut self) -> String {
        while !self.open.is_empty() {
            self.close();
        }
        self.text
    }

    fn tag(&mut self, name: &str, attributes: &[Attribute<'_>]) {
        self.text.push('<');
        self.text.push_str(name);
        for (key, value) in attributes {
            self.text.push(' ');
            self.text.push_str(key);
            self.text.push_str("=\"");
            self.push(&value.to_string());
            self.text.push('"');
        }
    }

    /// Appends text as XML wants it; what XML cannot hold at all becomes the replacement character.
    fn push(&mut self, text: &str) {
        for letter in text.chars() {
            match letter {
                '&' => self.text.push_str("&amp;"),
                '<' => self.text.push_str("&lt;"),
                '>' => self.text.push_str("&gt;"),
                '"' => self.text.push_str("&quot;"),
                '\t' | '\n' => self.text.push(letter),
                '\u{fffe}' | '\u{ffff}' => self.text.push('\u{fffd}'),
                letter if letter.is_control() => self.text.push('\u{fffd}'),
                letter => self.text.push(letter),
            }
        }
    }
}

/// A colour as CSS has it.
pub(super) fn css(colour: RGBColor) -> String {
    let mut text = String::from("#");
    for part in [colour.0, colour.1, colour.2] {
        // Writing to a string cannot fail.
        let _ = write!(text, "{part:02x}");
    }
    text
}

/// A coordinate as precise as a picture needs it.
fn px(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_cannot_break_out_of_the_markup() {
        let mut svg = Svg::new((10.0, 10.0), ".a > .b { }");
        svg.open("g", &[("class", &"\"><script>")]);
        svg.hover("a < b & c\u{1}");
        let text = svg.finish();
        assert!(
            text.contains("&quot;&gt;&lt;script&gt;") && text.contains("a &lt; b &amp; c\u{fffd}"),
            "{text}"
        );
        assert!(!text.contains("<script"));
        assert!(text.ends_with("</g>\n</svg>\n"), "{text}");
    }
}
