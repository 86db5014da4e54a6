//! Models in text: a line an entry, two an image.

use super::PIXEL_OFFSET;
use super::camera_model::camera;
use super::error::ReadColmapError;
use super::model::{ColmapImage, ColmapModel, ColmapPixel, pose};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::str::FromStr;

pub(super) fn read(folder: &Path) -> Result<ColmapModel, ReadColmapError> {
    let mut model = ColmapModel::default();
    let file = TextFile::open(folder.join("cameras.txt"))?;
    for line in file.lines().filter(Line::is_entry) {
        let mut words = line.words();
        let (id, name) = (words.next("the camera's id")?, words.next::<String>("its model")?);
        let size = [words.next("its width")?, words.next("its height")?];
        model.cameras.insert(id, camera(id, &name, size, &words.rest("its parameters")?)?);
    }
    let file = TextFile::open(folder.join("images.txt"))?;
    let mut lines = file.lines();
    while let Some(line) = lines.find(Line::is_entry) {
        let mut words = line.words();
        let id = words.next("the image's id")?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = words.next("its pose")?;
        }
        let world_from_camera = pose(numbers).ok_or_else(|| line.damaged("an image has no valid pose"))?;
        let (camera, name) = (words.next("its camera")?, words.text());
        // The line of points may be empty, and is then no line without an entry.
        let pixels = lines.next().map_or(Ok(Vec::new()), |line| line.pixels())?;
        model.images.insert(id, ColmapImage { name, stamp_ns: None, camera, world_from_camera, pixels });
    }
    let file = TextFile::open(folder.join("points3D.txt"))?;
    for line in file.lines().filter(Line::is_entry) {
        let mut words = line.words();
        let id = words.next("the point's id")?;
        let position: [f64; 3] = [words.next("x")?, words.next("y")?, words.next("z")?];
        if !position.iter().all(|value| value.is_finite()) {
            return Err(line.damaged("the position of a point is not finite"));
        }
        model.points.insert(id, Vector3::from(position));
    }
    Ok(model)
}

struct TextFile {
    path: PathBuf,
    text: String,
}

impl TextFile {
    fn open(path: PathBuf) -> Result<TextFile, ReadColmapError> {
        match files::read_to_string(&path) {
            Ok(text) => Ok(TextFile { path, text }),
            Err(reason) => Err(ReadColmapError::File { path, reason }),
        }
    }

    fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        (1..).zip(self.text.lines()).map(|(number, text)| Line {
            path: &self.path,
            number,
            text: text.trim(),
        })
    }
}

struct Line<'a> {
    path: &'a Path,
    number: usize,
    text: &'a str,
}

impl<'a> Line<'a> {
    /// Whether it is more than a comment.
    fn is_entry(&self) -> bool {
        !self.text.is_empty() && !self.text.starts_with('#')
    }

    fn words(&self) -> Words<'_, 'a> {
        Words { line: self, rest: self.text }
    }

    /// `x y point` again and again; -1 is no point.
    fn pixels(&self) -> Result<Vec<ColmapPixel>, ReadColmapError> {
        let mut words = self.words();
        let mut pixels = Vec::new();
        while !words.rest.is_empty() {
            let pixel: [f64; 2] = [words.next("x")?, words.next("y")?];
            let pixel = pixel.map(|coordinate| coordinate - PIXEL_OFFSET);
            let point: i64 = words.next("the id of a point")?;
            if let Ok(point) = u64::try_from(point) {
                pixels.push(ColmapPixel { pixel, point });
            }
        }
        Ok(pixels)
    }

    fn damaged(&self, problem: &str) -> ReadColmapError {
        ReadColmapError::Damaged {
            path: self.path.to_owned(),
            position: format!("line {}", self.number),
            problem: problem.to_owned(),
        }
    }
}

/// The words of a line.
struct Words<'l, 'a> {
    line: &'l Line<'a>,
    rest: &'a str,
}

impl Words<'_, '_> {
    fn next<T: FromStr>(&mut self, what: &str) -> Result<T, ReadColmapError> {
        let end = self.rest.find(char::is_whitespace).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest.trim_start();
        word.parse()
            .map_err(|_| self.line.damaged(&format!("{what} is missing or cannot be read: \"{word}\"")))
    }

    fn rest(&mut self, what: &str) -> Result<Vec<f64>, ReadColmapError> {
        let mut numbers = Vec::new();
        while !self.rest.is_empty() {
            numbers.push(self.next(what)?);
        }
        Ok(numbers)
    }

    /// All that is left: the name of a file may have blanks.
    fn text(&mut self) -> String {
        std::mem::take(&mut self.rest).to_owned()
    }
}
