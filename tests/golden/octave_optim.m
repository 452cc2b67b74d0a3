% Prints octave_optim.csv: where nonlin_residmin of the Octave package optim ends on a closed form.
%   octave-cli octave_optim.m > octave_optim.csv        (GNU Octave 7.3.0, optim 1.6.2, struct 1.0.18)
1;
pkg load optim

function r = residuals (point, calibrated, WRL, effect)
  global LOWER UPPER CONSTANT
  x = CONSTANT; x(calibrated) = point;
  u = (x - LOWER) ./ (UPPER - LOWER);
  angle = 21.9 + 5.6 * u(2) + 3.5 * u(4) + effect * (u(3) - u(5) + 0.5 * u(1) + 0.3 * u(6));
  solid = 0.62 - 0.03 * u(2) - 0.005 * u(3) - 0.005 * u(4)^2;
  best = x; worst = x;
  if any (calibrated == 1) best(1) = UPPER(1); worst(1) = LOWER(1); end
  if any (calibrated == 6) best(6) = LOWER(6); worst(6) = UPPER(6); end
  step = @(x) sqrt (x(1) / x(6));
  late = (step (best) - step (x)) / (step (best) - step (worst));
  r = [angle / 26.4 - 1; x(1) * solid / 1500 - 1; WRL * late];
end

function r = counted (varargin)
  global CALLS
  CALLS++;
  r = residuals (varargin{:});
end

global LOWER UPPER CONSTANT CALLS
NAMES = {"DENS", "MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM"};
LOWER = [2400; 0.1; 0.1; 0.001; 0.001; 417500000];
UPPER = [2600; 0.3; 0.3; 0.1; 0.1; 650000000];
CONSTANT = [0; 0.2; 0.2; 0; 0.01; 506000000];
printf ("calibrated,WRL,effect,tolerance,iterations,evaluations,sum_of_squares,optimum\n");
for chosen = {[1 4], [1 4 6], [1 3 4 6], [1 3 4 5 6], [1 2 4 5 6], [1 2 3 4 5], 1:6}
  calibrated = chosen{1};
  for WRL = [0 1]
    for effect = [1e-7 1e-2 0.1 0.3]
      for tolerance = [0.02 0.002]
        CALLS = 0;
        low = LOWER(calibrated); high = UPPER(calibrated);
        options = optimset ("TolFun", tolerance, "lbound", low, "ubound", high);
        f = @(p) counted (p, calibrated, WRL, effect);
        [p, r, cvg, out] = nonlin_residmin (f, (low + high) / 2, options);
        printf ("%s,%d,%g,%g,%d,%d,%.10e,%s\n", strjoin (NAMES(calibrated), " "), WRL, effect, tolerance, ...
                out.niter, CALLS, sumsq (r), strtrim (sprintf ("%.12g ", p)));
      end
    end
  end
end
