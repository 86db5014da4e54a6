//! Pixels as drivers give them: read, or refused by the names of the topic and of the encoding.

use super::making::{Body, Made, Message, frames, messages};

const CAMERA: [&str; 1] = ["/cam0/image_raw"];

/// A recording whose images are changed.
fn with_images(change: fn(&mut ros_messages::sensor_msgs::Image)) -> Vec<Message> {
    let mut all = messages(1);
    for message in &mut all {
        if let Body::Image(image) = &mut message.body {
            change(image);
        }
    }
    all
}

#[test]
fn odd_but_clear_images_are_read() {
    let expected = frames(&Made::new(&messages(1), &CAMERA).open().unwrap());
    for (name, all) in [
        ("upper case", with_images(|image| image.encoding = "MONO8".to_owned())),
        ("a step of zero", with_images(|image| image.step = 0)),
        (
            "luma in a plane of its own",
            with_images(|image| {
                image.encoding = "nv21".to_owned();
                image.data.extend([128; 24]);
            }),
        ),
        (
            "12 bits in two bytes",
            with_images(|image| {
                image.encoding = "mono16".to_owned();
                image.step *= 2;
                image.data =
                    image.data.iter().flat_map(|grey| (u16::from(*grey) << 4).to_le_bytes()).collect();
            }),
        ),
    ] {
        assert_eq!(frames(&Made::new(&all, &CAMERA).open().unwrap()), expected, "{name}");
    }
}

#[test]
fn luma_in_the_place_of_colours_is_named() {
    let all = with_images(|image| {
        image.encoding = "yuv422".to_owned();
        image.step *= 2;
        image.data = (0..48).flat_map(|pixel| [(pixel * 37 % 251) as u8, 128]).collect();
    });
    let error = Made::new(&all, &CAMERA).open().unwrap_err().to_string();
    assert!(error.contains(CAMERA[0]) && error.contains("\"yuv422\"") && error.contains("yuyv"), "{error}");
}

#[test]
fn images_that_no_one_can_use_are_refused_before_the_run() {
    for encoding in ["h264", ""] {
        let mut all = with_images(|_| {});
        for message in &mut all {
            if let Body::Image(image) = &mut message.body {
                encoding.clone_into(&mut image.encoding);
            }
        }
        let error = Made::new(&all, &CAMERA).open().unwrap_err().to_string();
        assert!(error.contains(CAMERA[0]) && error.contains(&format!("\"{encoding}\"")), "{error}");
        // Single ones are left to the run.
        let mut few = messages(1);
        for message in few.iter_mut().filter(|message| message.topic == CAMERA[0]).take(3) {
            if let Body::Image(image) = &mut message.body {
                encoding.clone_into(&mut image.encoding);
            }
        }
        assert_eq!(Made::new(&few, &CAMERA).open().unwrap().contents().frames, Some(40));
    }
}
