
const [first, last, full] = x.tags;
const whole = x.start <= first && x.end >= last;
ranges.forEach((range, i) => {
  const [bottom, top] = full[i];
  let low = top, high = bottom;
  const {t, ...curves} = sources[i].data;
  for (const y of Object.values(curves)) {
    for (let k = 0; k < t.length; k++) {
      if (t[k] >= x.start && t[k] <= x.end && isFinite(y[k])) {
        low = Math.min(low, y[k]);
        high = Math.max(high, y[k]);
      }
    }
  }
  low = Math.max(low, bottom);
  high = Math.min(high, top);
  const room = 0.06 * (high - low);
  range.setv(whole || !(high > low) ? {start: bottom, end: top} : {start: low - room, end: high + room});
});
