"""The surrogates: universal Kriging (section 2.3.2), from the covariance to a model of each response."""
