//! Messages as they come, and nonsense.

use super::*;

fn input(time: f64, kind: u8, a: f32, b: f32) -> Vec<u8> {
    let mut bytes = time.to_le_bytes().to_vec();
    bytes.push(kind);
    bytes.extend(a.to_le_bytes());
    bytes.extend(b.to_le_bytes());
    bytes
}

#[test]
fn texts_are_parsed_and_nonsense_is_not() {
    let hello = FromPage::parse(r#"{"type":"hello","v":1,"token":"x"}"#);
    assert_eq!(hello, Ok(FromPage::Hello { v: 1, token: "x".into(), resume: None, camera: None }));
    let set = FromPage::parse(r#"{"type":"set","key":"fps","value":12.5}"#);
    assert_eq!(set, Ok(FromPage::Set { key: "fps".into(), value: Value::Number(12.5) }));
    let set = FromPage::parse(r#"{"type":"set","key":"refines","value":true}"#);
    assert_eq!(set, Ok(FromPage::Set { key: "refines".into(), value: Value::Switch(true) }));
    assert_eq!(FromPage::parse(r#"{"type":"do","name":"take"}"#), Ok(FromPage::Do(Deed::Take)));
    let mark = FromPage::parse(r#"{"type":"do","name":"bookmark","number":2,"set":true}"#);
    assert_eq!(mark, Ok(FromPage::Do(Deed::Bookmark { number: 2, set: true })));
    let size = FromPage::parse(r#"{"type":"do","name":"size","width":640,"height":360}"#);
    assert_eq!(size, Ok(FromPage::Do(Deed::Size { width: 640, height: 360 })));
    let dim = FromPage::parse(r#"{"type":"do","name":"dim","lamp":1,"gain":0.5}"#);
    assert_eq!(dim, Ok(FromPage::Do(Deed::Dim { lamp: 1, gain: 0.5 })));
    for text in [
        "",
        "{}",
        "[]",
        r#"{"type":"hello"}"#,
        r#"{"type":"do","name":"rm"}"#,
        r#"{"type":"shown","frame":-1}"#,
        r#"{"type":"set","key":"fps","value":[1]}"#,
    ] {
        assert_eq!(FromPage::parse(text), Err(Malformed), "{text}");
    }
}

#[test]
fn input_is_parsed_and_nonsense_is_not() {
    let bytes = [input(5.0, 1, 3.0, 0.0), input(6.0, 3, 4.0, -2.0), input(7.0, 6, 0.0, 0.0)].concat();
    let events = parse_input(&bytes).expect("events");
    assert_eq!(events[0], Input { time: 5.0, act: Act::Press(Motion::Right) });
    assert_eq!(events[1], Input { time: 6.0, act: Act::Look(4.0, -2.0) });
    assert_eq!(events[2].act, Act::ReleaseAll);
    assert!(parse_input(&bytes[1..]).is_err() && parse_input(&[]).is_err());
    assert!(parse_input(&input(1.0, 9, 0.0, 0.0)).is_err());
    assert!(parse_input(&input(1.0, 1, 6.0, 0.0)).is_err());
    assert!(parse_input(&input(1.0, 3, f32::NAN, 0.0)).is_err());
    assert!(parse_input(&input(f64::INFINITY, 6, 0.0, 0.0)).is_err());
    assert!(parse_input(&input(1.0, 6, 0.0, 0.0).repeat(500)).is_err());
}

#[test]
fn cameras_come_back_as_they_went_and_no_others() {
    let camera = Camera { eye: Vec3::ONE, target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.7 };
    let numbers = camera_numbers(&camera);
    assert_eq!(camera_from(numbers), Some(camera));
    for (at, wrong) in [(0, f32::NAN), (3, f32::INFINITY), (1, 1e20), (9, 0.0), (9, 4.0)] {
        let mut numbers = numbers;
        numbers[at] = wrong;
        assert_eq!(camera_from(numbers), None, "{wrong} at {at}");
    }
    assert_eq!(camera_from([0.0; 10]), None);
}

#[test]
fn a_head_has_its_length() {
    let head = Head {
        exact: true,
        lossless: true,
        quality: 0,
        number: 7,
        view: 3,
        size: [512, 384],
        mark: 1.5,
        took: 0.0256,
    };
    let bytes = head.with(&Coded { tiles: vec![], columns: 0, bytes: vec![9] });
    assert_eq!((bytes.len(), bytes[..2].to_vec(), bytes[HEAD_BYTES]), (HEAD_BYTES + 1, vec![1, 3], 9));
    assert_eq!(bytes[8..12], [0, 2, 128, 1]);
    let some = head.with(&Coded { tiles: vec![[32, 0], [64, 288]], columns: 2, bytes: vec![9] });
    assert_eq!(some[12..18], [2, 0, 2, 0, TILE as u8, 0]);
    assert_eq!(some[18..20], [0, 1]);
    assert_eq!(
        Head { took: 60.0, ..head }.with(&Coded { tiles: vec![], columns: 0, bytes: vec![] })[18..20],
        [255; 2]
    );
    assert_eq!(some[HEAD_BYTES..], [32, 0, 0, 0, 64, 0, 32, 1, 9]);
    assert_eq!(f64::from_le_bytes(bytes[24..32].try_into().expect("eight bytes")), 1.5);
}
