//! Decisions in a walk's report: frame rate, quality, memory and levels over time (Dumont 2003, figure 13), and the bill.

use serde_json::Value;

use foveal_terminal::plots::Plot;
use foveal_terminal::report::Table;
use foveal_terminal::table::figure;

/// Textures that get a line of their own.
const LINES: usize = 8;

fn numbers(points: &[Value], of: impl Fn(&Value) -> f64) -> Vec<f32> {
    points.iter().map(|p| of(p) as f32).collect()
}

/// Frame rate and quality over the frames of a walk (Dumont 2003, figure 17).
pub fn rate_and_quality(document: &Value) -> Vec<Plot> {
    let (Some(ms), Some(quality)) =
        (document["over_time"]["frame_ms"].as_array(), document["over_time"]["quality"].as_array())
    else {
        return Vec::new();
    };
    let rate = numbers(ms, |ms| 1e3 / ms.as_f64().unwrap_or(f64::NAN));
    let loss = numbers(quality, |q| -q.as_f64().unwrap_or(f64::NAN));
    vec![
        Plot {
            title: "Frame rate".into(),
            caption: format!(
                "Blue: one over the time of each frame. Red: the rate that was asked for. {}",
                match document["mode"].as_str() {
                    Some("fixed-quality") => {
                        "The walk holds its quality, so the rate may dip below it where there is much to correct."
                    }
                    _ => "Blue should lie on red; a dip is a frame that came late.",
                }
            ),
            unit: "1/s",
            lines: vec![("frame rate".into(), rate)],
            limit: document["fps"].as_f64().map(|fps| fps as f32),
        },
        Plot {
            title: "Visible error".into(),
            caption:
                "The visible error left when a frame was shown, in just noticeable differences, the mean over its pixels as \
                 the allocator estimates it. Lower is better: it rises when the camera moves and falls while it rests."
                    .into(),
            unit: "JND",
            lines: vec![("−Q".into(), loss)],
            limit: None,
        },
    ]
}

/// Plots over the frames of a walk with limited textures; none of another walk.
pub fn plots(document: &Value) -> Vec<Plot> {
    let textures = &document["textures"];
    let (Some(points), Some(bill)) = (textures["over_time"].as_array(), textures["bill"].as_array()) else {
        return Vec::new();
    };
    let mib = |v: &Value| v.as_f64().unwrap_or(0.0) / f64::from(1 << 20);
    let of_texture = |key: &'static str, t: usize| move |p: &Value| p[key][t].as_f64().unwrap_or(0.0);
    // Those whose level changed most often tell most.
    let changes = |t: usize| {
        let levels = numbers(points, of_texture("finest", t));
        levels.windows(2).filter(|pair| pair[0] != pair[1]).count()
    };
    let mut order: Vec<usize> = (0..bill.len()).collect();
    order.sort_by_key(|&t| std::cmp::Reverse(changes(t)));
    order.truncate(LINES);
    let lines = |key: &'static str| {
        let name = |t: usize| bill[t]["texture"].as_str().unwrap_or_default().to_owned();
        order.iter().map(|&t| (name(t), numbers(points, of_texture(key, t)))).collect::<Vec<_>>()
    };
    vec![
        Plot {
            title: "Texture memory".into(),
            caption: "What the allocator counted and what the process held. Neither should cross red, the limit.".into(),
            unit: "MiB",
            lines: vec![
                ("counted".into(), numbers(points, |p| mib(&p["used_bytes"]))),
                ("held".into(), numbers(points, |p| mib(&p["held_bytes"]))),
            ],
            limit: Some(mib(&textures["limit_bytes"]) as f32),
        },
        Plot {
            title: "Mip levels".into(),
            caption: "The finest level in memory of the textures that changed most; 0 is full size. Textures that the camera \
                      comes near should fall."
                .into(),
            unit: "level",
            lines: lines("finest"),
            limit: None,
        },
        Plot {
            title: "Visible loss by texture".into(),
            caption: "What the same textures lose by the level they are given, in just noticeable differences × pixels: a \
                      spike is a texture that came near before its finer level was loaded."
                .into(),
            unit: "JND · pixels",
            lines: lines("losses"),
            limit: None,
        },
    ]
}

/// What each texture asked for, was given, and loses by the difference.
pub fn bill(document: &Value) -> Option<Table> {
    let textures = &document["textures"];
    let kib = |v: &Value| format!("{:.1}", v.as_f64().unwrap_or(0.0) / 1024.0);
    let row = |line: &Value| {
        vec![
            line["texture"].as_str().unwrap_or_default().to_owned(),
            format!("{:.0}", line["pixels"].as_f64().unwrap_or(0.0)),
            format!("{}", line["asked_level"]),
            kib(&line["asked_bytes"]),
            format!("{}", line["given_level"]),
            kib(&line["given_bytes"]),
            format!("{:.1}", line["visible_loss"].as_f64().unwrap_or(0.0)),
        ]
    };
    let price = textures["one_more_mib_buys"].as_f64()?;
    Some(Table {
        title: "The bill of textures".into(),
        caption: format!(
            "What each texture asked for, was given, and visibly loses by the difference, in JND · pixels, in the last \
             frame. One more MiB would buy {} of them.",
            figure(price)
        ),
        header: ["texture", "pixels", "level asked", "KiB asked", "level given", "KiB given", "visible loss"]
            .map(String::from)
            .to_vec(),
        rows: textures["bill"].as_array()?.iter().map(row).collect(),
    })
}

/// What each environment map asked for and was given, the most worth first.
pub fn map_bill(document: &Value) -> Option<Table> {
    let maps = &document["environment_maps"];
    let kib = |v: &Value| format!("{:.1}", v.as_f64().unwrap_or(0.0) / 1024.0);
    let row = |line: &Value| {
        vec![
            format!("{} {}", line["object"], line["name"].as_str().unwrap_or_default()),
            kib(&line["asked_bytes"]),
            kib(&line["given_bytes"]),
            format!("{:.1}", line["visible_loss"].as_f64().unwrap_or(0.0)),
        ]
    };
    let price = maps["one_more_mib_buys"].as_f64()?;
    Some(Table {
        title: "The bill of environment maps".into(),
        caption: format!(
            "What each map asked for, was given, and visibly loses by the difference, in JND · pixels · attention, the one \
             of most worth first. One more MiB would buy {} of them.",
            figure(price)
        ),
        header: ["object", "KiB asked", "KiB given", "visible loss"].map(String::from).to_vec(),
        rows: maps["bill"].as_array()?.iter().map(row).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_without_limit_has_no_bill() {
        assert!(plots(&Value::Null).is_empty() && bill(&Value::Null).is_none());
        assert!(map_bill(&Value::Null).is_none() && rate_and_quality(&Value::Null).is_empty());
    }
}
