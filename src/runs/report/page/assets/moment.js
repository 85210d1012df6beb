// A replay at a time: where the ego is, and which planning call was the last.

function mix(values, i, j, share) {
  return values[i] + (values[j] - values[i]) * share;
}

/** The ego's rear axle at a time, interpolated between samples. */
function momentAt(replay, time) {
  const { times, ego } = replay;
  const last = times.length - 1;
  let iteration = Math.min(last, Math.max(0, Math.floor(time * 10)));
  while (iteration > 0 && times[iteration] > time + 1e-6) iteration--;
  while (iteration < last && times[iteration + 1] <= time + 1e-6) iteration++;
  const next = Math.min(iteration + 1, last);
  const gap = times[next] - times[iteration];
  const share = gap > 0 ? Math.min(1, Math.max(0, (time - times[iteration]) / gap)) : 0;
  const pose = { x: mix(ego.x, iteration, next, share), y: mix(ego.y, iteration, next, share),
    heading: mix(ego.heading, iteration, next, share) };
  return { iteration, share, ...pose };
}

/** The center of the ego's box. */
function center({ x, y, heading }) {
  const ahead = INDEX.vehicle.rear_axle_to_center;
  return { x: x + Math.cos(heading) * ahead, y: y + Math.sin(heading) * ahead, heading };
}

/** The index of the last planning call up to an iteration, or −1. */
function callAt(replay, iteration) {
  let place = -1;
  replay.calls.forEach((call, i) => {
    if (call.iteration <= iteration) place = i;
  });
  return place;
}
