% CPU seconds of STK's maximin search, of its fit, and of its prediction of 10,000 points, on tests/golden.
%   octave-cli benchmarks/stk.m      in the root of the repository (Debian's packages octave, octave-stk)
% numerics.py runs it where Octave is installed. Lines: what, case, CPU s (median), smallest distance or nan.
pkg load stk
for shape = [12 36 54; 2 4 6]
  n = shape(1); d = shape(2);
  seconds = []; distances = [];
  for seed = 1:5
    rand ("twister", seed);
    before = cputime ();
    design = stk_sampling_maximinlhs (n, d, [zeros(1, d); ones(1, d)], 5000 * d);
    seconds(end+1) = cputime () - before;
    distances(end+1) = stk_mindist (design);
  end
  printf ("sampling,%dx%d,%.4f,%.4f\n", n, d, median (seconds), median (distances));
end
x = csvread ("tests/golden/kriging_design.csv", 1, 0);
[name, rep, point, value] = textread ("tests/golden/kriging_responses.csv", "%s %f %f %f", ...
                                      "delimiter", ",", "headerlines", 1);
low = min (x); x = (x - low) ./ (max (x) - low);
for response = {"AoR", "BD"}
  seconds = [];
  for k = 0:5
    z = value(strcmp (name, response{1}) & rep == k);
    model = stk_model ("stk_materncov_aniso", 4);
    model.lm = stk_lm_affine ();
    model.lognoisevariance = nan;
    before = cputime ();
    [model.param, model.lognoisevariance] = stk_param_estim (model, x, z);
    seconds(end+1) = cputime () - before;
  end
  printf ("fit,%s,%.4f,nan\n", response{1}, median (seconds));
  points = rand (10000, 4);
  before = cputime ();
  stk_predict (model, x, z, points);
  printf ("predict,%s,%.4f,nan\n", response{1}, cputime () - before);
end
