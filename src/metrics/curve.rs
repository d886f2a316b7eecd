//! Error over time: area under the curve and time to a threshold (REFERENCE §12.4).

/// How an error fell while a picture was corrected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorCurve {
    /// (time or rays, error), ascending in time.
    points: Vec<(f64, f64)>,
}

/// When an error first was at or below a share of its first value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeTo {
    /// The time, or the end of the curve where it was not reached.
    pub time: f64,
    /// Whether it was reached; if not the time is censored.
    pub reached: bool,
}

impl ErrorCurve {
    /// A curve that starts with the base picture's error at time 0.
    pub fn new(base_error: f64) -> Self {
        Self { points: vec![(0.0, base_error)] }
    }

    /// Records an error. Points that do not come after the last one replace it.
    pub fn push(&mut self, time: f64, error: f64) {
        while self.points.len() > 1 && self.points.last().is_some_and(|last| last.0 >= time) {
            self.points.pop();
        }
        if time > 0.0 {
            self.points.push((time, error));
        }
    }

    /// (time, error) of every record.
    pub fn points(&self) -> &[(f64, f64)] {
        &self.points
    }

    /// ∫ e dt / (T e(0)) over 0 … `end` by trapezoids, the last error held to the end: 1 where nothing ever improves,
    /// 0 where there is no error or no time.
    pub fn area(&self, end: f64) -> f64 {
        let Some(&(_, base)) = self.points.first() else { return 0.0 };
        if base <= 0.0 || end <= 0.0 {
            return 0.0;
        }
        let mut sum = 0.0;
        for pair in self.points.windows(2) {
            let [(t0, e0), (t1, e1)] = [pair[0], pair[1]];
            if t0 >= end {
                break;
            }
            let share = ((end - t0) / (t1 - t0)).min(1.0);
            sum += (t1 - t0) * share * (e0 + 0.5 * share * (e1 - e0));
        }
        if let Some(&(t, e)) = self.points.last().filter(|last| last.0 < end) {
            sum += (end - t) * e;
        }
        sum / (end * base)
    }

    /// When the error first was ≤ `share` of its first value, on straight lines between records.
    pub fn time_to(&self, share: f64) -> TimeTo {
        let Some(&(_, base)) = self.points.first() else { return TimeTo { time: 0.0, reached: false } };
        let target = share * base;
        let mut before = (0.0, base);
        for &(t, e) in &self.points {
            if e <= target {
                let step = before.1 - e;
                let time =
                    if step > 0.0 { before.0 + (t - before.0) * (before.1 - target) / step } else { t };
                return TimeTo { time, reached: true };
            }
            before = (t, e);
        }
        TimeTo { time: before.0, reached: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(points: &[(f64, f64)]) -> ErrorCurve {
        let mut curve = ErrorCurve::new(2.0);
        points.iter().for_each(|&(t, e)| curve.push(t, e));
        curve
    }

    #[test]
    fn areas_are_those_of_trapezoids() {
        assert_eq!(curve(&[]).area(5.0), 1.0);
        assert_eq!(curve(&[(4.0, 0.0)]).area(4.0), 0.5);
        assert_eq!(curve(&[(4.0, 0.0)]).area(8.0), 0.25);
        assert_eq!(curve(&[(4.0, 0.0)]).area(2.0), 0.75);
        assert_eq!(curve(&[(1.0, 1.0), (3.0, 1.0)]).area(4.0), (1.5 + 2.0 + 1.0) / 8.0);
        assert_eq!(ErrorCurve::new(0.0).area(1.0), 0.0);
        assert_eq!(curve(&[]).area(0.0), 0.0);
        assert_eq!(ErrorCurve::default().area(1.0), 0.0);
    }

    #[test]
    fn times_are_interpolated_or_censored() {
        let c = curve(&[(2.0, 1.0), (4.0, 0.5)]);
        assert_eq!(c.time_to(0.5), TimeTo { time: 2.0, reached: true });
        assert_eq!(c.time_to(0.75), TimeTo { time: 1.0, reached: true });
        assert_eq!(c.time_to(0.25), TimeTo { time: 4.0, reached: true });
        assert_eq!(c.time_to(0.1), TimeTo { time: 4.0, reached: false });
    }

    #[test]
    fn a_record_of_the_same_time_replaces_the_last() {
        assert_eq!(curve(&[(2.0, 1.0), (2.0, 0.5)]).points(), [(0.0, 2.0), (2.0, 0.5)]);
        assert_eq!(curve(&[(0.0, 1.0)]).points(), [(0.0, 2.0)]);
    }
}
