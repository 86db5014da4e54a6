//! Writes a [`Sequence`] in the EuRoC layout, which [`Sequence::open`] reads.
//!
//! Numbers are written with all digits: reading gives the same bits back, except for rotations, which are normalized
//! and come back to 15 digits.

use crate::{Frame, GnssReading, GnssSensor, ImageData, SensorCalibration, Sequence, SequenceError};
use calibration::sensor_yaml::{text_of_camera, text_of_imu};
use calibration::wheel_yaml::text_of_wheels;
use geometry::pose::Pose;
use nalgebra::Vector3;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use types::hexadecimal;

/// Writes every file of a recording below `root`, which is created.
///
/// Images are listed and not written: copy them to `mav0/cam0/data` under [`image_name`], else what is read again has tracks
/// and features only. Of the covariances of reference poses the largest standard deviations are written.
///
/// # Errors
/// [`SequenceError::Io`] with the file that could not be written.
pub fn write(sequence: &Sequence, root: &Path) -> Result<(), SequenceError> {
    let mav = root.join("mav0");
    write_calibration(&sequence.calibration(), root)?;
    if sequence.imu.is_some() {
        write_file(&mav.join("imu0/data.csv"), |out| imu_rows(out, sequence))?;
    }
    if !sequence.wheel_readings.is_empty() {
        write_file(&mav.join("wheels0/data.csv"), |out| {
            let columns = sequence.wheels.map(|wheels| wheels.base.kind()).unwrap_or_default().columns();
            let units = columns.iter().map(|name| {
                let unit = if *name == "steering" { "rad" } else { "rad s^-1" };
                format!("{name} [{unit}]")
            });
            writeln!(out, "#timestamp [ns],{}", units.collect::<Vec<_>>().join(","))?;
            let mut rows = sequence.wheel_readings.iter();
            rows.try_for_each(|row| {
                let values: Vec<String> = row.values[..columns.len()].iter().map(f64::to_string).collect();
                writeln!(out, "{},{}", row.stamp_ns, values.join(","))
            })
        })?;
    }
    if !sequence.gnss_readings.is_empty() {
        write_file(&mav.join("gnss0/data.csv"), |out| gnss_rows(out, &sequence.gnss_readings))?;
    }
    for index in 0..sequence.cameras.len() {
        let folder = mav.join(format!("cam{index}"));
        write_file(&folder.join("data.csv"), |out| image_rows(out, &sequence.frames, index))?;
        let tracked = |frame: &Frame| frame.tracks.iter().any(|track| usize::from(track.camera) == index);
        if sequence.frames.iter().any(tracked) {
            write_file(&folder.join("tracks.csv"), |out| track_rows(out, &sequence.frames, index))?;
        }
        if sequence.frames.iter().any(|frame| frame.features.contains_key(&index)) {
            write_file(&folder.join("features.csv"), |out| feature_rows(out, &sequence.frames, index))?;
        }
    }
    if let Some(truth) = &sequence.groundtruth {
        write_file(&mav.join("state_groundtruth_estimate0/data.csv"), |out| {
            writeln!(
                out,
                "#timestamp [ns],p_x [m],p_y,p_z,q_w,q_x,q_y,q_z,v_x [m s^-1],v_y,v_z,\
                 b_w_x [rad s^-1],b_w_y,b_w_z,b_a_x [m s^-2],b_a_y,b_a_z"
            )?;
            for row in truth {
                write!(out, "{},{}", row.stamp_ns, pose_cells(&row.pose))?;
                for vector in [row.velocity, row.gyroscope_bias, row.accelerometer_bias] {
                    match vector {
                        Some(vector) => write!(out, ",{}", vector_cells(&vector))?,
                        None => write!(out, ",nan,nan,nan")?,
                    }
                }
                writeln!(out)?;
            }
            Ok(())
        })?;
    }
    if let Some(poses) = &sequence.reference_poses {
        write_file(&root.join("reference_poses.csv"), |out| {
            writeln!(
                out,
                "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w,q_x,q_y,q_z,sigma_theta [rad],sigma_p [m]"
            )?;
            poses.iter().try_for_each(|row| {
                let pose = pose_cells(&row.pose);
                let (sigma_theta_rad, sigma_p_m) = row.largest_sigmas();
                writeln!(out, "{},{pose},{sigma_theta_rad},{sigma_p_m}", row.stamp_ns)
            })
        })?;
    }
    Ok(())
}

/// Writes only the `sensor.yaml` files, below `root`, which is created.
///
/// # Errors
/// [`SequenceError::Io`] with the file that could not be written.
pub fn write_calibration(calibration: &SensorCalibration, root: &Path) -> Result<(), SequenceError> {
    if let Some(imu) = &calibration.imu {
        write_file(&root.join("mav0/imu0/sensor.yaml"), |out| out.write_all(text_of_imu(imu).as_bytes()))?;
    }
    if let Some(wheels) = &calibration.wheels {
        write_file(&root.join("mav0/wheels0/sensor.yaml"), |out| {
            out.write_all(text_of_wheels(wheels).as_bytes())
        })?;
    }
    if let Some(gnss) = &calibration.gnss {
        write_file(&root.join("mav0/gnss0/sensor.yaml"), |out| gnss_yaml(out, gnss))?;
    }
    for (index, camera) in calibration.cameras.iter().enumerate() {
        let path = root.join(format!("mav0/cam{index}/sensor.yaml"));
        write_file(&path, |out| out.write_all(text_of_camera(camera).as_bytes()))?;
    }
    Ok(())
}

/// Name of an image's file in the EuRoC layout: its time, and the extension of the file that it comes from.
pub fn image_name(stamp_ns: i64, image: Option<&ImageData>) -> String {
    let extension = image.and_then(ImageData::path).and_then(Path::extension);
    format!("{stamp_ns}.{}", extension.map_or("png".into(), OsStr::to_string_lossy))
}

/// Writes only the tracks, one `tracks.csv` for each of the first `cameras` cameras, below `root`.
///
/// # Errors
/// [`SequenceError::Io`] with the file that could not be written.
pub fn write_tracks(frames: &[Frame], cameras: usize, root: &Path) -> Result<(), SequenceError> {
    for index in 0..cameras {
        let path = root.join(format!("mav0/cam{index}/tracks.csv"));
        write_file(&path, |out| track_rows(out, frames, index))?;
    }
    Ok(())
}

type Out = BufWriter<File>;

fn write_file(path: &Path, fill: impl FnOnce(&mut Out) -> std::io::Result<()>) -> Result<(), SequenceError> {
    let create = || {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let mut out = BufWriter::new(File::create(path)?);
        fill(&mut out)?;
        out.flush()
    };
    create().map_err(|source| SequenceError::io(path, source))
}

fn vector_cells(vector: &Vector3<f64>) -> String {
    format!("{},{},{}", vector.x, vector.y, vector.z)
}

fn pose_cells(pose: &Pose) -> String {
    let q = pose.rotation.quaternion();
    format!("{},{},{},{},{}", vector_cells(&pose.translation), q.w, q.i, q.j, q.k)
}

/// Positions with the standard deviations along the axes; correlations between them are not kept.
fn gnss_rows(out: &mut Out, readings: &[GnssReading]) -> std::io::Result<()> {
    writeln!(out, "#timestamp [ns],x [m],y [m],z [m],sigma_x [m],sigma_y [m],sigma_z [m]")?;
    readings.iter().try_for_each(|reading| {
        let sigma = reading.covariance.diagonal().map(f64::sqrt);
        let numbers: Vec<String> = reading.position.iter().chain(&sigma).map(f64::to_string).collect();
        writeln!(out, "{},{}", reading.stamp_ns, numbers.join(","))
    })
}

/// Without the origin: the positions that are written are in the frame of the map.
pub(crate) fn gnss_yaml(out: &mut impl Write, gnss: &GnssSensor) -> std::io::Result<()> {
    let list = |values: &Vector3<f64>| format!("[{}, {}, {}]", values.x, values.y, values.z);
    writeln!(out, "sensor_type: gnss")?;
    writeln!(out, "antenna: {}", list(&gnss.antenna_in_imu))?;
    if let Some(sigma_m) = &gnss.sigma_m {
        writeln!(out, "noise: {}", list(sigma_m))?;
    }
    gnss.correlation_time_s.map_or(Ok(()), |seconds| writeln!(out, "correlation_time: {seconds}"))
}

fn imu_rows(out: &mut Out, sequence: &Sequence) -> std::io::Result<()> {
    writeln!(out, "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z")?;
    sequence.imu_samples.iter().try_for_each(|sample| {
        let rates = vector_cells(&sample.gyroscope);
        writeln!(out, "{},{rates},{}", sample.stamp_ns, vector_cells(&sample.accelerometer))
    })
}

/// Of a recording without images all frames are listed.
fn image_rows(out: &mut Out, frames: &[Frame], camera: usize) -> std::io::Result<()> {
    writeln!(out, "#timestamp [ns],filename")?;
    let image = |frame: &Frame| frame.images.get(&camera).cloned();
    let has_images = frames.iter().any(|frame| image(frame).is_some());
    frames.iter().filter(|frame| !has_images || image(frame).is_some()).try_for_each(|frame| {
        writeln!(out, "{},{}", frame.stamp_ns, image_name(frame.stamp_ns, image(frame).as_ref()))
    })
}

fn track_rows(out: &mut Out, frames: &[Frame], camera: usize) -> std::io::Result<()> {
    writeln!(out, "#timestamp [ns],feature_id,u [px],v [px]")?;
    for frame in frames {
        for track in frame.tracks.iter().filter(|track| usize::from(track.camera) == camera) {
            let (stamp, pixel) = (frame.stamp_ns, track.pixel);
            writeln!(out, "{stamp},{},{},{}", track.feature_id, pixel.x, pixel.y)?;
        }
    }
    Ok(())
}

fn feature_rows(out: &mut Out, frames: &[Frame], camera: usize) -> std::io::Result<()> {
    writeln!(out, "#timestamp [ns],u [px],v [px],descriptor [hex]")?;
    for frame in frames {
        let Some(features) = frame.features.get(&camera) else { continue };
        for (index, [u, v]) in features.pixels.iter().enumerate() {
            let descriptor = hexadecimal::encode(features.descriptors.get(index).unwrap_or_default());
            writeln!(out, "{},{u},{v},{descriptor}", frame.stamp_ns)?;
        }
    }
    Ok(())
}
