#include "factors/bordered_envelope.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <utility>

namespace synchronizar {

BorderedEnvelope::BorderedEnvelope(std::vector<int> sizes, std::vector<int> first)
    : sizes_(std::move(sizes)), first_(std::move(first)) {
  for (int a = 0; a < groups(); ++a) {
    begin_.push_back(blocks_.size());
    for (int b = from(a); b <= a; ++b) blocks_.emplace_back(Eigen::MatrixXd::Zero(size(a), size(b)));
  }
}

void BorderedEnvelope::damp(double factor) {
  for (int a = 0; a < groups(); ++a) block(a, a).diagonal() *= factor;
}

bool BorderedEnvelope::factorize() {
  for (int a = 0; a < groups(); ++a) {
    for (int b = from(a); b < a; ++b) {
      Eigen::MatrixXd& here = block(a, b);
      for (int c = std::max(from(a), from(b)); c < b; ++c) {
        here.noalias() -= block(a, c) * block(b, c).transpose();
      }
      block(b, b).triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(here);
    }
    Eigen::MatrixXd& own = block(a, a);
    for (int c = from(a); c < a; ++c) own.selfadjointView<Eigen::Lower>().rankUpdate(block(a, c), -1.0);
    if (Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(own).info() != Eigen::Success) return false;
  }
  return true;
}

double BorderedEnvelope::log_determinant() const {
  double sum = 0.0;
  for (int a = 0; a < groups(); ++a) sum += block(a, a).diagonal().array().log().sum();
  return 2.0 * sum;
}

void BorderedEnvelope::solve(Sides& sides) const {
  const auto of = [&](int group) -> Eigen::MatrixXd& { return sides[static_cast<size_t>(group)]; };
  for (int a = 0; a < groups(); ++a) {
    for (int b = from(a); b < a; ++b) of(a).noalias() -= block(a, b) * of(b);
    block(a, a).triangularView<Eigen::Lower>().solveInPlace(of(a));
  }
  for (int a = groups() - 1; a >= 0; --a) {
    block(a, a).triangularView<Eigen::Lower>().transpose().solveInPlace(of(a));
    for (int b = from(a); b < a; ++b) of(b).noalias() -= block(a, b).transpose() * of(a);
  }
}

BorderedEnvelope BorderedEnvelope::inverse() const {
  // Takahashi, Fagan and Chin (PICA 1973): from the last group to the first, each from those after it.
  BorderedEnvelope out(sizes_, first_);
  std::vector<std::vector<int>> after(sizes_.size());
  for (int a = 0; a < groups(); ++a) {
    for (int b = from(a); b < a; ++b) after[static_cast<size_t>(b)].push_back(a);
  }
  for (int g = groups() - 1; g >= 0; --g) {
    const auto& others = after[static_cast<size_t>(g)];
    const auto own = block(g, g).triangularView<Eigen::Lower>();
    Sides by_own;
    for (const int k : others) {
      by_own.push_back(block(k, g));
      own.solveInPlace<Eigen::OnTheRight>(by_own.back());
    }
    Eigen::MatrixXd root = Eigen::MatrixXd::Identity(size(g), size(g));
    own.solveInPlace(root);
    Eigen::MatrixXd& diagonal = out.block(g, g);
    diagonal.noalias() = root.transpose() * root;
    for (const int i : others) {
      Eigen::MatrixXd& here = out.block(i, g);
      for (size_t n = 0; n < others.size(); ++n) {
        const int k = others[n];
        if (i >= k) {
          here.noalias() -= out.block(i, k) * by_own[n];
        } else {
          here.noalias() -= out.block(k, i).transpose() * by_own[n];
        }
      }
    }
    for (size_t n = 0; n < others.size(); ++n) {
      diagonal.noalias() -= by_own[n].transpose() * out.block(others[n], g);
    }
  }
  return out;
}

}  // namespace synchronizar
