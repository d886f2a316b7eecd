//! A control as it is set on a command line: `exposure=-1`.

use std::fmt::Write;
use std::str::FromStr;

use super::{Control, Kind, Refused, Value, controls};
use crate::source::{Controls, Ranges};

/// A control and what it is set to.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Which.
    pub key: &'static str,
    /// To what.
    pub value: Value,
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or("say KEY=VALUE, as in exposure=-1")?;
        let control = controls().iter().find(|control| control.key == key.trim());
        let control = control.ok_or_else(|| {
            let keys: Vec<&str> = controls().iter().map(|control| control.key).collect();
            format!("there is nothing to set called \"{key}\"; there are {}", keys.join(", "))
        })?;
        let value = value.trim();
        Ok(Self { key: control.key, value: control.parse(value)? })
    }
}

impl Control {
    /// Its value as somebody writes it.
    fn parse(&self, text: &str) -> Result<Value, String> {
        match self.kind {
            Kind::Slider { .. } => {
                let number: Option<f64> = text.parse().ok().filter(|number: &f64| number.is_finite());
                number.map(Value::Number).ok_or_else(|| format!("\"{text}\" is no number"))
            }
            Kind::Choice(names) => match names.contains(&text) {
                true => Ok(Value::Name(text.to_owned())),
                false => Err(format!("\"{text}\" is none of {}", names.join(", "))),
            },
            Kind::Switch => match text {
                "on" | "true" => Ok(Value::Switch(true)),
                "off" | "false" => Ok(Value::Switch(false)),
                _ => Err(format!("\"{text}\" is neither on nor off")),
            },
        }
    }

    /// What may be written for it.
    fn values(&self) -> String {
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        match self.kind {
            // How far these go is known of a walk alone.
            Kind::Slider { least, most, .. } if least == most => format!("a number{unit}"),
            Kind::Slider { least, most, .. } => format!("{least} to {most}{unit}"),
            Kind::Choice(names) => names.join(", "),
            Kind::Switch => "on, off".to_owned(),
        }
    }
}

impl Controls {
    /// Sets all of these, in their order.
    ///
    /// # Errors
    /// If the walk has no use for one.
    pub fn put_all(&mut self, settings: &[Setting], ranges: &Ranges) -> Result<(), Refused> {
        settings.iter().try_for_each(|Setting { key, value }| self.put(key, value, ranges))
    }
}

/// All controls as lines of a help text, by group.
pub fn help() -> String {
    let mut text = "Controls, for --set KEY=VALUE; panels have the same:\n".to_owned();
    let mut group = "";
    for control in controls() {
        if control.group != group {
            group = control.group;
            let _ = writeln!(text, "  {group}");
        }
        let needs = control.needs.map_or_else(String::new, |key| format!("; needs {key}=on"));
        let _ = writeln!(text, "    {:<18} {} ({}{needs})", control.key, control.help, control.values());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_as_they_are_written() {
        let read = |text: &str| text.parse::<Setting>();
        assert_eq!(read("exposure=-1"), Ok(Setting { key: "exposure", value: Value::Number(-1.0) }));
        assert_eq!(read(" refines = off "), Ok(Setting { key: "refines", value: Value::Switch(false) }));
        let overlay = Setting { key: "overlay", value: Value::Name("object ids".into()) };
        assert_eq!(read("overlay=object ids"), Ok(overlay));
        for (text, told) in [
            ("exposure", "KEY=VALUE"),
            ("brightness=1", "exposure, compresses"),
            ("exposure=inf", "no number"),
            ("exposure=", "no number"),
            ("overlay=all", "object ids"),
            ("waits=1", "neither on nor off"),
        ] {
            assert!(read(text).is_err_and(|e| e.contains(told)), "{text}");
        }
    }

    #[test]
    fn the_help_has_each_control_once() {
        let text = help();
        for control in controls() {
            let begin = format!("    {} ", control.key);
            assert_eq!(text.matches(&begin).count(), 1, "{}", control.key);
            assert!(text.contains(control.help));
        }
        assert!(text.contains("-12 to 12 stops") && text.contains("needs waits=on"));
    }
}
