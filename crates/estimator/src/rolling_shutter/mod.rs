//! Rolling shutters: the rows of an image are read out one after the other, while the camera moves.
//!
//! An image's stamp is the time of its middle row. With `H` rows and the readout time `r` from the first row to that after the last one,
//! row `v` was taken
//! ```text
//! τ(v) = ((v + ½) / H - ½) r
//! ```
//! after it, and a camera that is exposed later than the stamp of its frame by a delay (Kalibr's `timeshift_cam_imu` of several cameras) that much
//! later. A pixel is predicted from the IMU's pose at the time of its own row, as measured: a pixel of error is a row, some
//! ten microseconds.
//!
//! # Pose of a row
//! The readings of the IMU about the image give the motion `Δ(τ)` from the clone `T_i` to the row, and, between images, the motion
//! `M` to the next clone `T_k` in time. Where the estimates of the two clones differ from `M` by now, the row takes the part of the
//! difference that is due at its time, `w = τ / (t_k - t_i)`:
//! ```text
//! T(τ) = E^w T_i Δ(τ),     E = T_k (T_i M)⁻¹
//! ```
//! So the readings give the shape of the motion within the interval, and the clones its ends. Interpolation of the clones' poses
//! alone would have to be right between images 50 ms apart (a hand that turns faster by 10 rad/s² is 1 mrad off, half a pixel), and
//! the readings alone need the velocity at the image, which is no part of a clone: taken as exact, it would tell the scale of
//! a single camera. The error of the row is linear in those of the clones, exact where both move with L,
//! ```text
//! δθ = Σ w_j δθ_j     δp = Σ w_j (δp_j + δθ_j x (p - p_j)),     w_i = 1 - w, w_k = w,
//! ```
//! which interpolates the errors, not the poses; those change slowly, by biases. A turn and a shift of L are the same turn
//! and shift of every row at any point of linearization, so that they stay unobservable.
//!
//! The upper rows of an image (`τ < 0`) lie between its clone and the one before, the lower ones between its clone and the next one. The
//! newest clone has no next one yet, the oldest one none before: there the neighbour on the other side stands in, with a negative
//! weight of at most some tenths. Beyond the newest reading of the IMU the motion goes on as it is; the next image's readings replace
//! that.
//!
//! Sources: Guo, Kottas, DuToit, Ahmed, Li & Roumeliotis, "Efficient visual-inertial navigation using a rolling-shutter camera with
//! inaccurate timestamps", RSS 2014 (interpolation between clones); Li & Mourikis, "Vision-aided inertial navigation with
//! rolling-shutter cameras", IJRR 2014 (the IMU's motion with an approximation of its error only).

pub mod motion_around;
pub mod row_pose;
pub mod still_pixel;
