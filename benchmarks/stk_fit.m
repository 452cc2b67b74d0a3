% CPU seconds of STK's fit, and of its prediction of 10,000 points, on tests/golden.
%   octave-cli benchmarks/stk_fit.m      in the root of the repository (Debian's packages octave, octave-stk)
pkg load stk
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
  points = rand (10000, 4);
  before = cputime ();
  stk_predict (model, x, z, points);
  printf ("%s: fit %.2f (%.2f to %.2f), predict 10,000 points %.2f CPU s\n", response{1}, ...
          median (seconds), min (seconds), max (seconds), cputime () - before);
end
