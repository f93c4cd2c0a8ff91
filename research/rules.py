import pickle,numpy as np
R=pickle.load(open("/tmp/e60/curves.pkl","rb"))
def choose(r,ev,base):
    mis=np.array(r["mis"]); pw=np.array(r["powers"]); a=r["allowed"]*ev
    if base=="noise": a=r["allowed"]*ev
    most=mis.min()+a; last=int(np.flatnonzero(mis<=most)[-1])
    e=pw[last]
    if last+1<len(pw): e+=(most-mis[last])/(mis[last+1]-mis[last])
    return e
def loss(r,lam):
    le=np.log([q["err"] for q in r["rows"]]); L=np.log(r["lams"]); x=np.log(lam)
    if x<L[-1]: return float(np.exp(le[-1]-le.min()+.4*(L[-1]-x)))
    return float(np.exp(np.interp(x,L[::-1],le[::-1])-le.min()))
for kappa in (2,3.5):
  for split in (0,1):
    for kn in ((1,) if not split else (.6,.8,1)):
      for ev in (.15,.2,.25,.3,.4):
        out=[]
        for r in R:
            e=choose(r,ev,"m"); nc,mc=r["fc"]; nf,mf=r["ff"]
            chosen2=(nc+3.5*mc)*4.0**e   # squared force chosen at coarse
            if split:
                rho2=max(0.0,(chosen2-kn**2*nc)/(mc)) if mc>0 else 1
                f2=kn**2*nf+rho2*mf
            else: f2=chosen2*(nf+kappa*mf)/(nc+kappa*mc)
            out.append(loss(r,r["unit"]*np.sqrt(f2)))
        print("kappa",kappa,"split",split,"kn",kn,"ev",ev,"median %.3f p90 %.3f max %.2f mean %.3f"%(np.median(out),np.percentile(out,90),max(out),np.mean(out)), np.round(out,2) if ev==.25 else "")
