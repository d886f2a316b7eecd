//! Textures in a walk's report: memory, quality and levels over time (Dumont 2003, figure 13), and the bill.

use serde_json::Value;

use super::report::{Plot, Table};

/// Textures that get a line of their own.
const LINES: usize = 8;

fn numbers(points: &[Value], of: impl Fn(&Value) -> f64) -> Vec<f32> {
    points.iter().map(|p| of(p) as f32).collect()
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
            caption: "By the allocator's count and as the process held it; red: the limit.".into(),
            unit: "MiB",
            lines: vec![
                ("counted".into(), numbers(points, |p| mib(&p["used_bytes"]))),
                ("held".into(), numbers(points, |p| mib(&p["held_bytes"]))),
            ],
            limit: Some(mib(&textures["limit_bytes"]) as f32),
        },
        Plot {
            title: "Mip levels".into(),
            caption: "The finest level in memory of the textures that changed most; 0 is full size.".into(),
            unit: "level",
            lines: lines("finest"),
            limit: None,
        },
        Plot {
            title: "Visible loss".into(),
            caption: "−q of the same textures, just noticeable differences × pixels.".into(),
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
        title: format!("The bill of textures: one more MiB would buy {price:.3} JND · pixels"),
        header: ["texture", "pixels", "level asked", "KiB", "level given", "KiB", "visible loss"]
            .map(String::from)
            .to_vec(),
        rows: textures["bill"].as_array()?.iter().map(row).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_without_limit_has_no_bill() {
        assert!(plots(&Value::Null).is_empty() && bill(&Value::Null).is_none());
    }
}
