//! Models in binary: little endian, without padding.

use super::PIXEL_OFFSET;
use super::camera_model::{camera, numbered};
use super::error::ReadColmapError;
use super::model::{ColmapImage, ColmapModel, ColmapPixel, pose};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// The number of a point that an image sees but the model does not have.
const NO_POINT: u64 = u64::MAX;

pub(super) fn read(folder: &Path) -> Result<ColmapModel, ReadColmapError> {
    let mut model = ColmapModel::default();
    let mut file = Reader::open(folder.join("cameras.bin"))?;
    for _ in 0..file.u64()? {
        let id = file.u32()?;
        let number = file.i32()?;
        let (name, parameters) = numbered(id, number)?;
        let size = [file.u64()?, file.u64()?].map(|side| u32::try_from(side).unwrap_or(0));
        let parameters: Vec<f64> = (0..parameters).map(|_| file.f64()).collect::<Result<_, _>>()?;
        model.cameras.insert(id, camera(id, name, size, &parameters)?);
    }
    file.end()?;
    let mut file = Reader::open(folder.join("images.bin"))?;
    for _ in 0..file.u64()? {
        let (id, image) = file.image()?;
        model.images.insert(id, image);
    }
    file.end()?;
    let mut file = Reader::open(folder.join("points3D.bin"))?;
    for _ in 0..file.u64()? {
        let id = file.u64()?;
        let position = Vector3::from(file.f64s::<3>()?);
        if !position.iter().all(|value| value.is_finite()) {
            return Err(file.damaged("the position of a point is not finite"));
        }
        model.points.insert(id, position);
        // Colour, error, and the track, which the images give too.
        file.bytes(3 + 8)?;
        let track = file.u64()?;
        file.bytes(usize::try_from(track.saturating_mul(8)).unwrap_or(usize::MAX))?;
    }
    file.end()?;
    Ok(model)
}

/// A file that is read from its begin to its end.
struct Reader {
    path: PathBuf,
    bytes: Vec<u8>,
    position: usize,
}

impl Reader {
    fn open(path: PathBuf) -> Result<Reader, ReadColmapError> {
        match files::read(&path, files::MAX_TEXT_BYTES) {
            Ok(bytes) => Ok(Reader { path, bytes, position: 0 }),
            Err(reason) => Err(ReadColmapError::File { path, reason }),
        }
    }

    fn image(&mut self) -> Result<(u32, ColmapImage), ReadColmapError> {
        let id = self.u32()?;
        let numbers = self.f64s::<7>()?;
        let Some(world_from_camera) = pose(numbers) else {
            return Err(self.damaged("an image has no valid pose"));
        };
        let camera = self.u32()?;
        let length = self.bytes[self.position..].iter().position(|byte| *byte == 0);
        let Some(length) = length else { return Err(self.damaged("the name of an image does not end")) };
        let name = String::from_utf8_lossy(self.bytes(length)?).into_owned();
        self.bytes(1)?;
        let mut pixels = Vec::new();
        for _ in 0..self.u64()? {
            let pixel = self.f64s::<2>()?.map(|coordinate| coordinate - PIXEL_OFFSET);
            let point = self.u64()?;
            if point != NO_POINT {
                pixels.push(ColmapPixel { pixel, point });
            }
        }
        Ok((id, ColmapImage { name, stamp_ns: None, camera, world_from_camera, pixels }))
    }

    fn bytes(&mut self, count: usize) -> Result<&[u8], ReadColmapError> {
        let begin = self.position;
        let end = begin.checked_add(count).filter(|end| *end <= self.bytes.len());
        let Some(end) = end else { return Err(self.damaged("the file ends early")) };
        self.position = end;
        Ok(&self.bytes[begin..end])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], ReadColmapError> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N)?);
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32, ReadColmapError> {
        self.array().map(u32::from_le_bytes)
    }

    fn i32(&mut self) -> Result<i32, ReadColmapError> {
        self.array().map(i32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, ReadColmapError> {
        self.array().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, ReadColmapError> {
        self.array().map(f64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], ReadColmapError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Ok(numbers)
    }

    fn end(&self) -> Result<(), ReadColmapError> {
        if self.position == self.bytes.len() {
            Ok(())
        } else {
            Err(self.damaged("something follows the last entry"))
        }
    }

    fn damaged(&self, problem: &str) -> ReadColmapError {
        ReadColmapError::Damaged {
            path: self.path.clone(),
            position: format!("byte {}", self.position),
            problem: problem.to_owned(),
        }
    }
}
