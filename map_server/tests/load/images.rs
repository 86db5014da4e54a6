//! Images whose decoding and search cost as much as the limits allow, and their way to the page.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

use image::{ImageFormat, Rgba, RgbaImage};

/// Columns and rows of the largest image that the live map takes.
const SIDE: u16 = map_server::images::MAX_IMAGE_SIDE as u16;
/// Blocks of 8 x 8 pixels in it.
const BLOCKS: usize = (SIDE as usize / 8).pow(2);

/// The calibration of these images.
fn calibration() -> String {
    format!("resolution: [{SIDE}, {SIDE}]\ncamera_model: pinhole\nintrinsics: [3000, 3000, 2048, 2048]\n")
}

/// An image with corners everywhere, in four channels.
pub fn costly_png() -> Vec<u8> {
    let side = u32::from(SIDE);
    let shade = |x: u32, y: u32| ((x / 8 * 7 + y / 8 * 13) % 5 * 50) as u8;
    let image = RgbaImage::from_fn(side, side, |x, y| Rgba([shade(x, y), shade(y, x), 90, 255]));
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, ImageFormat::Png).unwrap();
    let file = file.into_inner();
    assert!(file.len() < viewer::MAX_IMAGE_BYTES, "{} bytes", file.len());
    file
}

/// A progressive image of as many scans as are taken, each of which says of every block that it has nothing more.
pub fn costly_jpeg() -> Vec<u8> {
    let [high, low] = SIDE.to_be_bytes();
    let mut file = vec![0xff, 0xd8];
    let mut segment = |kind: u8, body: &[u8]| {
        file.extend_from_slice(&[0xff, kind]);
        file.extend_from_slice(&(body.len() as u16 + 2).to_be_bytes());
        file.extend_from_slice(body);
    };
    segment(0xdb, &[&[0][..], &[1; 64]].concat());
    segment(0xc2, &[8, high, low, high, low, 1, 1, 0x11, 0]);
    // One code of one bit in each table: a difference of zero, the end of a block.
    for table in [0x00, 0x10] {
        segment(0xc4, &[&[table, 1][..], &[0; 15], &[0]].concat());
    }
    for scan in 0..vision::MAX_SCANS {
        let [first, last] = if scan == 0 { [0, 0] } else { [1, 63] };
        file.extend_from_slice(&[0xff, 0xda, 0, 8, 1, 1, 0, first, last, 0]);
        file.resize(file.len() + BLOCKS / 8, 0);
    }
    file.extend_from_slice(&[0xff, 0xd9]);
    assert!(file.len() < viewer::MAX_IMAGE_BYTES, "{} bytes", file.len());
    file
}

/// Gives an image to the page; the status of the answer.
///
/// # Errors
/// Where the page does not answer.
pub fn post(address: &str, map: &str, file: &[u8]) -> std::io::Result<u16> {
    let escaped = calibration().bytes().fold(String::new(), |mut text, byte| {
        let _ = std::fmt::Write::write_fmt(&mut text, format_args!("%{byte:02x}"));
        text
    });
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_mins(1)))?;
    let length = file.len();
    write!(
        stream,
        "POST /api/maps/{map}/localize?calibration={escaped} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\
         Content-Length: {length}\r\n\r\n"
    )?;
    stream.write_all(file)?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok());
    status.ok_or_else(|| std::io::Error::other(answer))
}
