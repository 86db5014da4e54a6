//! Laws of the alignment of patches, on images whose motion is known exactly.

mod common;

use common::{Motion, SIZE, Texture};
use nalgebra::Vector2;
use vision::tracking::{AlignmentOptions, Warp, align_mutually};
use vision::{CornerOptions, Pyramid, detect_corners};

#[test]
fn explore() {
    let texture = Texture::new(1);
    let first = Motion::NONE.render(|x, y| texture.at(x, y), 1);
    let corners = detect_corners(&first, &[], None, 200, &CornerOptions::default());
    println!("{} corners", corners.len());
    let pyramid = Pyramid::new(first, 5);
    for (shift, degrees, zoom, gain, bias) in [
        ([0.3, -0.2], 0.0, 1.0, 1.0, 0.0),
        ([3.3, -2.2], 0.0, 1.0, 1.0, 0.0),
        ([12.3, -16.2], 0.0, 1.0, 1.0, 0.0),
        ([12.3, -16.2], 0.0, 1.0, 0.7, 20.0),
        ([2.3, -6.2], 10.0, 1.0, 1.0, 0.0),
        ([2.3, -6.2], 0.0, 1.1, 1.0, 0.0),
        ([2.3, -6.2], 0.0, 0.9, 1.0, 0.0),
        ([2.3, -6.2], 5.0, 1.05, 0.8, 10.0),
        ([12.3, -16.2], 10.0, 1.1, 0.7, 20.0),
    ] {
        let motion = Motion { shift, degrees, zoom, gain, bias };
        let second = Pyramid::new(motion.render(|x, y| texture.at(x, y), 2), 5);
        for (levels, known) in [(4, false), (5, false), (4, true)] {
            let options = AlignmentOptions { levels, ..AlignmentOptions::default() };
            let (mut inside, mut found, mut good) = (0, 0, 0);
            let mut errors = vec![];
            for corner in &corners {
                let truth = motion.map(corner.pixel.cast());
                if truth.x < 8.0
                    || truth.y < 8.0
                    || truth.x > SIZE[0] as f64 - 9.0
                    || truth.y > SIZE[1] as f64 - 9.0
                {
                    continue;
                }
                inside += 1;
                let mut guess = Warp::moved_to(corner.pixel);
                if known {
                    guess.centre = (truth - Vector2::from(shift)).cast();
                }
                if let Ok(hit) = align_mutually(&pyramid, &second, corner.pixel, &guess, &options) {
                    found += 1;
                    let error = (hit.warp.centre.cast() - truth).norm();
                    errors.push(error);
                    if error < 0.2 {
                        good += 1;
                    }
                }
            }
            errors.sort_by(f64::total_cmp);
            println!(
                "{motion:?} {levels} {known}: {inside} inside {:.3} survive, {:.3} good, median {:.4}",
                found as f64 / inside as f64,
                good as f64 / found as f64,
                errors[errors.len() / 2]
            );
        }
    }
}
